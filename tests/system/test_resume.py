"""PHM's state survives a crash of PHM: with a fault open, given up, advised, or in the middle of a recovery action."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from sitl.harness.log_follower import Event
from tests.system.conftest import AppContainer, Phm, config_for, poll


def kill(phm: Phm) -> None:
    assert phm.process is not None
    phm.process.kill()
    phm.process.wait()


def saved_state(phm: Phm) -> dict[str, Any]:
    path = phm.folder / "state" / "state.json"
    document: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    return document


def start_again(phm: Phm) -> int:
    """Start PHM again; return the position in the record where it begins."""
    mark = phm.mark()
    phm.start()
    return mark


def judged(unit: str) -> Callable[[Event], bool]:
    """Whether a report has the unit in ERROR by a new result, not by the saved one."""

    def wanted(event: Event) -> bool:
        return (
            event["event"] == "unit"
            and event["unit"] == unit
            and event["level"] == "ERROR"
            and "restored" not in event["summary"]
        )

    return wanted


def closed(fault: str) -> Callable[[Event], bool]:
    return lambda event: event["event"] == "fault_closed" and event["fault"] == fault


def test_an_advised_fault_stays_the_same_and_can_be_approved(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """Killed with an advised fault open: no second alarm or advice, the same id; approval recovers it."""
    phm = start_phm(config_for(app, recovery={"mode": "advise"}), app.domain)
    phm.wait_all_ok()
    app.container.kill()
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the fault")
    phm.wait(lambda event: event["event"] == "action" and event["phase"] == "advised", "the advice")
    poll(
        lambda: bool(saved_state(phm).get("cases", {}).get(opened["fault"], {}).get("reported")),
        "the state on the disk",
    )
    kill(phm)
    mark = start_again(phm)
    phm.wait(judged(opened["unit"]), "a fresh judgement", since=mark)
    assert phm.opened(mark) == []
    assert [event for event in phm.record.events[mark:] if event["event"] == "action"] == []
    listed = json.loads(phm.cli("faults", "--json", "-c", str(phm.config)).stdout)
    assert [fault["fault"] for fault in listed["faults"] if fault["outcome"] == "open"] == [opened["fault"]]
    asked = phm.cli("approve", opened["fault"])
    assert (asked.returncode, asked.stdout.startswith("approved: start")) == (0, True), asked.stderr
    end = phm.wait(closed(opened["fault"]), "the end of the fault", since=mark)
    assert (end["outcome"], end["by"]) == ("resolved", "start")
    steps = phm.cli("faults", opened["fault"], "-c", str(phm.config)).stdout
    assert steps.index("start advised") < steps.index("start approved") < steps.index("start verified")


def test_a_fault_that_was_given_up_stays_given_up(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """Killed after giving up: the budget is saved; no alarm and no action follow until the unit was OK."""
    recovery = {"same_failure": 1, "verify": "1s", "ladders": {"unhealthy": ["unpause"]}}
    phm = start_phm(config_for(app, recovery=recovery), app.domain)
    phm.wait_all_ok()
    app.run("touch", "/tmp/unhealthy")
    given_up = phm.wait(lambda event: event["event"] == "fault_closed" and event["outcome"] == "escalated", "giving up")
    poll(lambda: bool(saved_state(phm).get("given_up")), "the state on the disk")
    kill(phm)
    mark = start_again(phm)
    phm.wait(judged(given_up["unit"]), "a fresh judgement", since=mark)
    assert len(saved_state(phm)["attempts"][app.name]) == 1
    app.run("rm", "/tmp/unhealthy")
    phm.wait_all_ok(mark)
    assert phm.opened(mark) == []
    assert [event for event in phm.record.events[mark:] if event["event"] == "action"] == []
    poll(lambda: saved_state(phm)["given_up"] == [], "the case being closed")


def test_an_interrupted_restart_is_resumed(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """The interrupted action is reported and counted, and the new PHM recovers the same fault without another alarm."""
    config = config_for(app, recovery={"ladders": {"unhealthy": ["restart"]}})
    phm = start_phm(config, app.domain)
    phm.wait_all_ok()
    app.run("touch", "/tmp/unhealthy")
    started = phm.wait(lambda event: event["event"] == "action" and event["phase"] == "started", "a restart")
    poll(lambda: bool(saved_state(phm).get("under_way")), "the action on the disk")
    kill(phm)
    mark = start_again(phm)
    note = phm.wait(lambda event: event["event"] == "note" and "interrupted" in event["text"], "the note", since=mark)
    assert started["fault"] in note["text"]
    end = phm.wait(closed(started["fault"]), "the end of the fault", since=mark)
    assert end["outcome"] == "resolved"
    phm.wait_all_ok(mark)
    assert phm.opened(mark) == []
    attempts = saved_state(phm)["attempts"][app.name]
    assert attempts[0]["action"] == "restart"
    assert attempts[0]["worked"] is False
