"""PHM is the last thing to die: its own parts killed, stopped and starved under a running daemon."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial

from sitl.harness.log_follower import Event
from tests.system.conftest import Aboard, Phm, config_for, poll


def unit_report(event: Event, unit: str, level: str) -> bool:
    return event["event"] in ("unit", "transition") and event["unit"] == unit and event["level"] == level


def told(condition: str, event: Event) -> bool:
    return event["event"] == "transition" and event["unit"] == "companion" and event["condition"] == condition


def test_the_ros_child_is_replaced_while_the_rest_goes_on(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """Killed and stopped: no fault of the vehicle, reports go on, and the nodes are known again."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    for number in (signal.SIGKILL, signal.SIGSTOP):
        mark = phm.mark()
        (child,) = phm.children()
        child.send_signal(number)
        phm.wait(lambda event: unit_report(event, "nodes/agent_1/node_1", "STALE"), "the nodes unknown", since=mark)
        poll(lambda old=child.pid: [c.pid for c in phm.children()] not in ([], [old]), "a new child")  # type: ignore[misc]
        phm.wait_all_well(mark)
        assert phm.opened(mark) == []
        reports = [event for event in phm.record.events[mark:] if event["event"] == "report"]
        assert all(event["status_array"][:5] == [1] * 5 for event in reports)


def test_killed_and_started_again_it_goes_on(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """SIGKILL leaves the log readable and no child behind; the next start needs no cleaning."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    children = [child.pid for child in phm.children()]
    assert phm.process is not None
    phm.process.kill()
    phm.process.wait()
    assert phm.cli("status", "--healthy").returncode == 1
    poll(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in children), "the ROS child's end")
    mark = phm.mark()
    assert mark > 0
    phm.start()
    phm.wait(partial(told, "phm_restarted"), "the word that it had ended badly", since=mark)
    phm.wait_all_well(mark)
    assert phm.cli("status", "--healthy").returncode == 0
    assert len({event["boot_id"] for event in phm.record.events}) == 2


def test_stopped_as_a_whole_it_is_let_go_on_and_says_so(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """SIGSTOP to the daemon: its guard notices; the same process goes on, with no fault of the vehicle."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    mark = phm.mark()
    assert phm.process is not None
    phm.process.send_signal(signal.SIGSTOP)
    phm.wait(partial(told, "phm_suspended"), "the word that it stood still", since=mark)
    assert phm.process.poll() is None
    phm.wait_all_well(phm.mark())
    assert phm.opened(mark) == []


def test_sigterm_ends_it_in_order(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """Exit 0, the status file gone, no child left, no traceback."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    children = [child.pid for child in phm.children()]
    assert phm.stop() == 0
    assert not (phm.folder / "run" / "status.json").exists()
    assert not any(os.path.exists(f"/proc/{pid}") for pid in children)
    assert "Traceback" not in phm.output()


def test_without_an_engine_it_starts_says_so_and_stays(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """No engine at the socket: one fault, at the engine; everything that needs it is blocked by it."""
    config = config_for(app, docker={"socket": "unix:///nonexistent/docker.sock", "timeout": "1s"})
    phm = start_phm(config, app.domain)
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the engine's fault")
    assert opened["unit"] == "engine"
    phm.wait(lambda event: event["event"] == "report" and event["number"] >= 4, "reports going on")
    assert phm.opened(0) == ["engine"]
    assert phm.cli("status", "--healthy").returncode == 0
