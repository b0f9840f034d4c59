"""Real faults on a real agent: one alarm, at its cause, recovered and verified."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from docker import DockerClient

from sitl.faults import _docker_proxy
from sitl.faults.base import freeze
from sitl.harness.log_follower import Event
from tests.fakes.until import until
from tests.system.conftest import AppContainer, Phm, config_for

SETTLED_S = 10.0
"""A fault is observed for this long after its recovery: longer than the grace of any unit."""


def end_from_within(app: AppContainer) -> None:
    """The command may end with the container, and the engine forgets it then: its exit code is not asked for."""
    api = app.client.api
    api.exec_start(api.exec_create(app.container.id, ["kill", "-USR2", "1"])["Id"], detach=True)


CASES: dict[str, tuple[str, str, Callable[[AppContainer], object]]] = {
    "node killed": ("nodes/agent_1/node_1", "restart", lambda app: app.kill_node("node_1")),
    "container killed": ("container/{name}", "start", lambda app: app.container.kill()),
    "container stopped": ("container/{name}", "start", end_from_within),
    "container paused": ("container/{name}", "unpause", lambda app: freeze(app.container)),
    "unhealthy": ("health/{name}", "restart", lambda app: app.run("touch", "/tmp/unhealthy")),
    "network lost": ("network/{name}", "reconnect", lambda app: app.network.disconnect(app.container, force=True)),
}


def settled(phm: Phm, mark: int, from_mono: float) -> None:
    """Observe the log until `SETTLED_S` after `from_mono`."""
    phm.wait(lambda event: event["mono"] > from_mono + SETTLED_S, "the log going on", since=mark)


@pytest.mark.parametrize("case", CASES)
def test_one_fault_raises_one_alarm_and_is_recovered(
    case: str, app: AppContainer, start_phm: Callable[..., Phm]
) -> None:
    """Exactly one fault is opened, at the right unit, resolved by the right action and verified."""
    unit, action, inject = CASES[case]
    unit = unit.format(name=app.name)
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    inject(app)
    closed = phm.wait(
        lambda event: event["event"] == "fault_closed" and event["unit"] == unit, f"{unit} recovered", since=mark
    )
    settled(phm, mark, closed["mono"])
    assert phm.opened(mark) == [unit]
    assert closed["outcome"] == "resolved"
    steps = [(event["phase"], event["action"]) for event in phm.record.events[mark:] if event["event"] == "action"]
    assert steps[0] == ("started", action)
    # Where DDS does not reconnect over a new interface, the next step of the ladder follows; it stays one fault.
    assert steps[-1] == ("verified", closed["by"])
    assert closed["by"] in (action, "restart")
    phm.wait_all_ok(phm.mark())


@pytest.fixture
def door() -> Iterator[Path]:
    """A socket through which PHM reaches the engine. Not in the folder of the test, whose path may be too long for one."""
    with tempfile.TemporaryDirectory(prefix="phm-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, "engine.sock")
        _docker_proxy.start(path)
        yield path
        _docker_proxy.stop(path)


def test_a_container_that_ends_while_the_engine_is_away_is_reported_then(
    app: AppContainer, start_phm: Callable[..., Phm], door: Path
) -> None:
    """It is one alarm while PHM has no engine, and recovered once it has one; its nodes are none."""
    phm = start_phm(config_for(app, docker={"socket": f"unix://{door}"}), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    _docker_proxy.block(door, 3600.0)
    opened = ["engine", f"container/{app.name}"]
    phm.wait(lambda event: event["event"] == "fault_opened", "the engine's fault", since=mark)
    app.container.kill()
    ended = phm.wait(lambda event: event["event"] == "fault_opened" and event["unit"] == opened[1], "its", since=mark)
    assert ended["condition"] == "ended"
    settled(phm, mark, ended["mono"])
    assert phm.opened(mark) == opened
    back = phm.mark()
    _docker_proxy.block(door, 0.0)
    closed = phm.wait(
        lambda event: event["event"] == "fault_closed" and event["unit"] == opened[1], "the container's end", since=back
    )
    assert (closed["outcome"], closed["by"], closed["condition"]) == ("resolved", "start", "exited")
    phm.wait_all_ok(back)
    settled(phm, mark, closed["mono"])
    assert phm.opened(mark) == opened


@pytest.mark.parametrize("recovery", [{"mode": "off"}, {"mode": "advise"}])
def test_off_and_advise_change_nothing_in_the_world(
    recovery: dict[str, Any], app: AppContainer, start_phm: Callable[..., Phm]
) -> None:
    """A stopped container stays stopped; `advise` states the recommended action."""
    phm = start_phm(config_for(app, recovery=recovery), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    app.container.kill()
    before = app.identity()
    last = phm.wait(lambda event: event["event"] == "fault_opened", "the fault", since=mark)
    if recovery["mode"] == "advise":
        last = phm.wait(lambda event: event["event"] == "action", "the advice", since=mark)
    settled(phm, mark, last["mono"])
    assert app.identity() == before
    assert before[2] == "exited"
    phases = [event["phase"] for event in phm.record.events[mark:] if event["event"] == "action"]
    assert phases == (["advised"] if recovery["mode"] == "advise" else [])


def test_a_container_that_has_not_opted_in_is_left_alone(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """No `recover: true`, no action, in any mode."""
    config = config_for(app)
    del config["containers"][0]["recover"]
    phm = start_phm(config, app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    app.container.kill()
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the fault", since=mark)
    settled(phm, mark, opened["mono"])
    assert app.identity()[2] == "exited"
    assert not [event for event in phm.record.events[mark:] if event["event"] == "action"]


def test_two_dead_nodes_are_two_faults_and_one_restart_recovers_both(
    app: AppContainer, start_phm: Callable[..., Phm]
) -> None:
    """Independent faults are reported separately; the action that recovers both runs once."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    app.run("sh", "-c", "kill -KILL $(cat /tmp/nodes/node_1.pid) $(cat /tmp/nodes/node_2.pid)")
    opened: list[str] = []

    def over(event: Event) -> bool:
        """On a busy machine the second death may be detected when the restart for the first is already running."""
        if event["event"] == "fault_opened":
            opened.append(event["unit"])
        elif event["event"] == "fault_closed":
            opened.remove(event["unit"])
            return not opened
        return False

    last = phm.wait(over, "the end of all faults", since=mark)
    settled(phm, mark, last["mono"])
    assert set(phm.opened(mark)) <= {"nodes/agent_1/node_1", "nodes/agent_1/node_2"}
    started = [
        event for event in phm.record.events[mark:] if event["event"] == "action" and event["phase"] == "started"
    ]
    assert len(started) == 1


def test_once_prints_the_state_and_changes_nothing(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """`phm once --json` beside a running daemon: the documented structure, all slots OK, exit 0."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    before = app.identity()
    passes: list[subprocess.CompletedProcess[str]] = []

    def all_ok() -> bool:
        """On a busy machine one pass may rightly find a topic too slow."""
        passes.append(phm.cli("once", "-c", str(phm.config), "--json"))
        return passes[-1].returncode == 0

    until(all_ok, "a pass with everything OK", lambda: passes[-1])
    report = json.loads(passes[-1].stdout)
    assert set(report) == {"agent", "status_array", "slots", "checks"}
    assert report["status_array"] == [1] * 8
    assert {"id", "slot", "layer", "level", "summary", "blocked_by", "duration_ms"} <= set(report["checks"][0])
    assert app.identity() == before


def test_once_names_a_fault_and_exits_1(
    app: AppContainer, docker_client: DockerClient, start_phm: Callable[..., Phm]
) -> None:
    """One pass finds the fault at its cause, and changes nothing."""
    phm = start_phm(config_for(app, recovery={"mode": "off"}), app.domain)
    phm.wait_all_ok()
    app.container.kill()
    done = phm.cli("once", "-c", str(phm.config), "--json")
    assert done.returncode == 1
    levels = {check["id"]: (check["level"], check["blocked_by"]) for check in json.loads(done.stdout)["checks"]}
    assert levels[f"container/{app.name}"] == ("ERROR", "")
    assert levels["nodes/agent_1/node_1"] == ("STALE", f"container/{app.name}")
    assert app.identity()[2] == "exited"
