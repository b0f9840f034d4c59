"""What PHM knew survives PHM: killed with a fault open, given up, advised, or in the middle of a repair."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from sitl.harness.log_follower import Event
from tests.system.conftest import Aboard, Phm, config_for, poll


def kill(phm: Phm) -> None:
    assert phm.process is not None
    phm.process.kill()
    phm.process.wait()


def kept(phm: Phm) -> dict[str, Any]:
    path = phm.folder / "state" / "state.json"
    document: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    return document


def start_again(phm: Phm) -> int:
    """Returns where the record of the new PHM begins."""
    mark = phm.mark()
    phm.start()
    return mark


def judged(unit: str) -> Callable[[Event], bool]:
    """A report in which the unit is ERROR by a fresh result, not by memory."""

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


def test_an_advised_fault_stays_the_same_and_can_be_approved(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """Killed with an advised fault open: no second alarm, no second advice, the same id; a yes heals it."""
    phm = start_phm(config_for(app, recovery={"mode": "advise"}), app.domain)
    phm.wait_all_well()
    app.container.kill()
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the fault")
    phm.wait(lambda event: event["event"] == "action" and event["phase"] == "advised", "the advice")
    poll(lambda: bool(kept(phm).get("cases", {}).get(opened["fault"], {}).get("reported")), "the state on the disk")
    kill(phm)
    mark = start_again(phm)
    phm.wait(judged(opened["unit"]), "a fresh judgement", since=mark)
    assert phm.opened(mark) == []
    assert [event for event in phm.record.events[mark:] if event["event"] == "action"] == []
    listed = json.loads(phm.cli("faults", "--json", "-c", str(phm.config)).stdout)
    assert [fault["fault"] for fault in listed["faults"] if fault["outcome"] == "open"] == [opened["fault"]]
    asked = phm.cli("approve", opened["fault"])
    assert (asked.returncode, asked.stdout.startswith("approved: start")) == (0, True), asked.stderr
    end = phm.wait(closed(opened["fault"]), "the end of the fault", 40, mark)
    assert (end["outcome"], end["by"]) == ("resolved", "start")
    steps = phm.cli("faults", opened["fault"], "-c", str(phm.config)).stdout
    assert steps.index("start advised") < steps.index("start approved") < steps.index("start verified")


def test_a_fault_that_was_given_up_stays_given_up(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """Killed after giving up: the budget is remembered, no alarm and no action follow, until the unit has been well."""
    recovery = {"same_failure": 1, "verify": "1s", "ladders": {"unhealthy": ["unpause"]}}
    phm = start_phm(config_for(app, recovery=recovery), app.domain)
    phm.wait_all_well()
    app.run("touch", "/tmp/unhealthy")
    given_up = phm.wait(
        lambda event: event["event"] == "fault_closed" and event["outcome"] == "escalated", "giving up", 40
    )
    poll(lambda: bool(kept(phm).get("given_up")), "the state on the disk")
    kill(phm)
    mark = start_again(phm)
    phm.wait(judged(given_up["unit"]), "a fresh judgement", since=mark)
    assert len(kept(phm)["attempts"][app.name]) == 1
    app.run("rm", "/tmp/unhealthy")
    phm.wait_all_well(mark)
    assert phm.opened(mark) == []
    assert [event for event in phm.record.events[mark:] if event["event"] == "action"] == []
    poll(lambda: kept(phm)["given_up"] == [], "the case being closed")


def test_killed_in_the_middle_of_a_restart_it_takes_it_up_again(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """The cut-short action is told and counted, and the same fault is healed by the new PHM with no further alarm."""
    config = config_for(app, recovery={"ladders": {"unhealthy": ["restart"]}})
    phm = start_phm(config, app.domain)
    phm.wait_all_well()
    app.run("touch", "/tmp/unhealthy")
    started = phm.wait(lambda event: event["event"] == "action" and event["phase"] == "started", "a restart", 40)
    poll(lambda: bool(kept(phm).get("under_way")), "the action on the disk", 5)
    kill(phm)
    mark = start_again(phm)
    note = phm.wait(lambda event: event["event"] == "note" and "interrupted" in event["text"], "the note", since=mark)
    assert started["fault"] in note["text"]
    end = phm.wait(closed(started["fault"]), "the end of the fault", 60, mark)
    assert end["outcome"] == "resolved"
    phm.wait_all_well(mark)
    assert phm.opened(mark) == []
    attempts = kept(phm)["attempts"][app.name]
    assert attempts[0]["action"] == "restart"
    assert attempts[0]["worked"] is False
