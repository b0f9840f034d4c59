"""PHM survives: its own processes are killed, stopped and starved under a running daemon."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial

from sitl.harness.log_follower import Event
from tests.system.conftest import AppContainer, Phm, config_for, poll


def unit_report(event: Event, unit: str, level: str) -> bool:
    return event["event"] in ("unit", "transition") and event["unit"] == unit and event["level"] == level


def warned(condition: str, event: Event) -> bool:
    return event["event"] == "transition" and event["unit"] == "companion" and event["condition"] == condition


def test_the_ros_child_is_replaced_while_the_rest_continues(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """Killed and stopped: no fault of the vehicle, reports continue, and the nodes are seen again."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    for number in (signal.SIGKILL, signal.SIGSTOP):
        mark = phm.mark()
        (child,) = phm.children()
        child.send_signal(number)
        phm.wait(lambda event: unit_report(event, "nodes/agent_1/node_1", "STALE"), "the nodes unknown", since=mark)
        poll(lambda old=child.pid: [c.pid for c in phm.children()] not in ([], [old]), "a new child")  # type: ignore[misc]
        phm.wait_all_ok(mark)
        assert phm.opened(mark) == []
        reports = [event for event in phm.record.events[mark:] if event["event"] == "report"]
        assert all(event["status_array"][:5] == [1] * 5 for event in reports)


def test_a_killed_daemon_starts_again_without_cleanup(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """SIGKILL leaves the log readable and no child behind."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    children = [child.pid for child in phm.children()]
    assert phm.process is not None
    phm.process.kill()
    phm.process.wait()
    assert phm.cli("status", "--healthy").returncode == 1
    poll(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in children), "the ROS child's end")
    mark = phm.mark()
    assert mark > 0
    phm.start()
    phm.wait(partial(warned, "phm_restarted"), "the warning that it terminated unexpectedly", since=mark)
    phm.wait_all_ok(mark)
    poll(lambda: phm.cli("status", "--healthy").returncode == 0, "a healthy daemon")
    assert len({event["boot_id"] for event in phm.record.events}) == 2


def test_a_suspended_daemon_is_resumed_and_reports_it(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """SIGSTOP to the daemon: its watchdog detects it; the same process continues, with no fault of the vehicle."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    assert phm.process is not None
    phm.process.send_signal(signal.SIGSTOP)
    phm.wait(partial(warned, "phm_suspended"), "the warning that it was suspended", since=mark)
    assert phm.process.poll() is None
    phm.wait_all_ok(phm.mark())
    assert phm.opened(mark) == []


def test_sigterm_shuts_the_daemon_down(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """Exit 0, the status file removed, no child left, no traceback."""
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    children = [child.pid for child in phm.children()]
    assert phm.stop() == 0
    assert not (phm.folder / "run" / "status.json").exists()
    # A killed child may take a moment longer on a busy machine.
    poll(lambda: not any(os.path.exists(f"/proc/{pid}") for pid in children), "the ROS child's end")
    assert "Traceback" not in phm.output()


def test_a_missing_engine_is_one_fault(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """No Docker Engine at the socket: the daemon starts with one fault, at the engine, which blocks all dependents."""
    config = config_for(app, docker={"socket": "unix:///nonexistent/docker.sock", "timeout": "1s"})
    phm = start_phm(config, app.domain)
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the engine's fault")
    assert opened["unit"] == "engine"
    phm.wait(lambda event: event["event"] == "report" and event["number"] >= 4, "reports going on")
    assert phm.opened(0) == ["engine"]
    poll(lambda: phm.cli("status", "--healthy").returncode == 0, "a healthy daemon")
