"""Reloading the configuration: an invalid one changes nothing, a valid one applies, and known states are kept."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from phm.api import error
from phm.checking.plan import CheckPlan
from phm.core.dependency_graph import DependencyGraph
from phm.facts import Attachment, ContainerFact
from phm.probes.docker import Docker
from phm.probes.docker_event import DockerEvent
from phm.recovery.operator.requests import OperatorRequests
from phm.recovery.persistence.state import PersistedState
from phm.runtime.configuration import Configuration
from phm.runtime.daemon import Daemon
from phm.runtime.main_loop import MainLoop
from phm.runtime.reloader import Reloader
from phm.runtime.wiring import build_daemon, build_successor
from phm.testing import settings
from phm.wire import control, json_log, status_file
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.runtime.running import LIMIT_S, PATIENT, ROOT, RUN, Running

HEARTBEAT, POWEROFF = 0, 8
LONG_LIMITS = """
import sys
from phm.probes.pattern_matcher import PatternMatcher
PatternMatcher.__init__.__defaults__ = (60.0,)
from phm.cli import main
main(sys.argv[1:])
"""
"""`phm` with a long limit for the search of patterns: a busy machine may delay the process that searches."""


class Agent:
    """`phm run` with a disk that exceeds its limit, and a ground station that receives its heartbeats."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port(socket.SOCK_DGRAM)
        self.ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.ground.bind(("127.0.0.1", self.port))
        self.ground.setblocking(False)
        self.write()
        self.process = subprocess.Popen(
            [sys.executable, "-c", LONG_LIMITS, "run", "-c", str(self.file)],
            text=True,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks"))), "PHM_WATCHDOG": "off"},
        )
        until(lambda: self.faults() == 1, "the fault of the disk")

    @property
    def file(self) -> Path:
        return self.folder / "phm.yaml"

    def write(self, **more: Any) -> None:
        folder = self.folder
        base = {
            "agent": {"id": 3},
            "interval": "2s",
            "state_dir": str(folder / "state"),
            "run_dir": str(folder / "run"),
            "log": {"directory": str(folder / "log")},
            "host": {"disk": {"warn": 0, "error": 0}},
            "mavlink": {"endpoints": [{"url": f"udpout:127.0.0.1:{self.port}", "leads_to": "ground"}]},
        }
        self.file.write_text(json.dumps({**base, **more}))

    def status(self) -> dict[str, Any]:
        try:
            return status_file.read(str(self.folder / "run"))
        except status_file.NoStatus:
            return {}

    def faults(self) -> int:
        return sum(fault["unit"] == "host/disk" for fault in self.status().get("faults", {}).get("open", ()))

    def reload(self, *more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "phm.cli", "reload", "--run-dir", str(self.folder / "run"), *more],
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            timeout=LIMIT_S,
            check=False,
        )

    def heartbeat_states(self) -> list[int]:
        """The system states of the heartbeats that arrived since the last call."""
        found = []
        while True:
            try:
                frame = self.ground.recv(512)
            except BlockingIOError:
                return found
            if frame[0] == 0xFD and int.from_bytes(frame[7:10], "little") == HEARTBEAT:
                found.append(frame[10 + 7])

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=LIMIT_S)
        self.ground.close()


@pytest.fixture
def agent(tmp_path: Path) -> Iterator[Agent]:
    made = Agent(tmp_path)
    yield made
    made.close()


def disk_fault(status: dict[str, Any]) -> str:
    """The id of the open fault of the disk; a busy machine may have others."""
    return next(str(fault["fault"]) for fault in status["faults"]["open"] if fault["unit"] == "host/disk")


def test_a_valid_configuration_applies_and_faults_stay_open(agent: Agent) -> None:
    """The fault keeps its id and is reported once; heartbeats continue without POWEROFF; keys that need a restart are
    named.
    """
    before = agent.status()
    agent.write(interval="3s", agent={"id": 3, "name": "other"})
    agent.heartbeat_states()
    done = agent.reload()
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "configuration reloaded: interval; restart PHM to apply: agent\n"
    until(lambda: agent.status().get("interval_s") == 3.0, "the new interval")
    until(lambda: agent.faults() == 1, "the fault")
    after = agent.status()
    assert after["pid"] == before["pid"]
    assert after["agent"] == before["agent"], "the agent's name stays until a restart"
    assert disk_fault(after) == disk_fault(before)
    seen: list[int] = []
    until(lambda: seen.extend(agent.heartbeat_states()) or len(seen) >= 3, "three heartbeats")
    assert POWEROFF not in seen
    opened = [
        each
        for each in json_log.read(agent.folder / "log")
        if each["event"] == "fault_opened" and each["unit"] == "host/disk"
    ]
    assert len(opened) == 1
    started = [each["machine_boot"] for each in json_log.read(agent.folder / "log") if each["event"] == "start"]
    assert len(started) == 2 and started[0] and started[0] == started[1]
    notes = [each["text"] for each in json_log.read(agent.folder / "log") if each["event"] == "note"]
    assert any(text.startswith("configuration reloaded: interval") for text in notes)


def test_a_hold_outlives_a_reload(agent: Agent) -> None:
    """An operator's hold lasts until its own end, and can be released afterwards."""
    run_dir = str(agent.folder / "run")
    control.ask(run_dir, {"do": "hold", "container": "", "for_s": 600.0, "reason": "maintenance"})
    agent.write(interval="3s")
    assert agent.reload().returncode == 0
    until(lambda: agent.status().get("interval_s") == 3.0, "the new interval")
    until(lambda: [hold["reason"] for hold in agent.status().get("holds", [])] == ["maintenance"], "the hold")
    control.ask(run_dir, {"do": "release", "container": ""})
    until(lambda: agent.status().get("holds") == [], "the release")


def test_a_successor_knows_what_cannot_be_observed_again(
    tmp_path: Path, patient: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """How a container that is disconnected now was connected, for `reconnect`; a fault that the main loop opens last; and the
    commands from the links."""
    patient()
    attached = Attachment("fleet", "n1", "172.30.0.5", aliases=("ros",), fixed_addresses=("172.30.0.5",))
    networks, handed, hand_over, join = [attached], list[PersistedState](), Daemon._hand_over, MainLoop.join

    def container(docker: Docker, name: str, young_s: float = 0.0) -> ContainerFact:
        return ContainerFact(name, "id", "running", "t", networks=tuple(networks))

    def handing_over(daemon: Daemon) -> PersistedState:
        handed.append(hand_over(daemon))
        return handed[-1]

    def last_iteration(loop: MainLoop, timeout_s: float) -> None:
        broken = error("broken", brief="broken", condition="broken")
        former.pipeline.observe({"custom/it": broken}, former.clock.mono(), 0.0)
        join(loop, timeout_s)

    monkeypatch.setattr(Docker, "container", container)
    monkeypatch.setattr(Daemon, "_hand_over", handing_over)
    monkeypatch.setattr(MainLoop, "join", last_iteration)
    folders = {"state_dir": str(tmp_path / "s"), "run_dir": str(tmp_path / "r"), "log": {"directory": str(tmp_path)}}
    more: dict[str, Any] = {
        **folders,
        "docker": {"socket": f"unix://{tmp_path}/none"},
        "custom": [{"name": "it", "type": "command", "command": ["true"], "period": "1h", "failures": 1, "grace": 0}],
        "mavlink": {"endpoints": [{"url": f"udpout:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"}]},
    }
    former = build_daemon(settings(containers=[{"name": "app"}, {"name": "a"}, {"name": "b", "alias": "x"}], **more))
    former.start()
    for name in ("app", "a", "x"):
        former.components.probes.docker.container(name)
    networks.clear()
    successor = build_successor(
        former, settings(containers=[{"name": "app", "recover": True}, {"name": "c", "alias": "x"}], **more)
    )
    successor.start()
    try:
        known = {name: successor.components.probes.docker.remembered(name, "fleet") for name in ("app", "a", "x")}
        assert known == {"app": attached, "a": None, "x": None}
        assert [fault.unit for state in handed for fault in state.faults if fault.unit == "custom/it"] == ["custom/it"]
        before, after = former.components.mavlink_commands, successor.components.mavlink_commands
        assert before is not None and after is not None and after._dedup is before._dedup
    finally:
        successor.stop()


HANDING_OVER = """
import pathlib, sys
from phm.runtime.daemon import Daemon
stop = Daemon._stop_recovery
def slow(daemon, closing):
    folder = pathlib.Path(sys.argv[-1]).parent
    (folder / "handing-over").touch()
    (folder / "go").read_bytes()  # a pipe: waits until the test has opened and closed it
    stop(daemon, closing)
    Daemon._stop_recovery = stop
Daemon._stop_recovery = slow
"""


def test_a_request_during_a_reload_is_refused_and_not_lost(tmp_path: Path) -> None:
    """The old daemon would execute it and the new one would not know of it: a hold would end immediately."""
    os.mkfifo(tmp_path / "go")
    phm, run_dir = Running(tmp_path, "-c", HANDING_OVER + PATIENT + RUN), str(tmp_path / "run")
    try:
        until(lambda: (tmp_path / "run" / "status.json").exists(), "the status", limit_s=LIMIT_S)
        phm.write(interval="3s")
        phm.process.send_signal(signal.SIGHUP)
        until((tmp_path / "handing-over").exists, "the reload", limit_s=LIMIT_S)
        request = {"do": "hold", "container": "", "for_s": 600.0, "reason": "maintenance"}
        with pytest.raises(control.Refused, match="PHM is starting"):
            control.ask(run_dir, request)
        (tmp_path / "go").write_bytes(b"")

        def accepted() -> bool:
            with contextlib.suppress(control.Refused):
                control.ask(run_dir, request)
                return True
            return False

        until(accepted, "an answer of the new daemon", limit_s=LIMIT_S)
    finally:
        phm.process.kill()
        phm.process.communicate(timeout=LIMIT_S)


def test_an_invalid_configuration_is_rejected_and_the_old_one_stays(agent: Agent) -> None:
    """Exit code 78 and every problem as file:line; nothing is stopped, nothing changes."""
    boot = agent.status()["boot_id"]
    agent.file.write_text("interval: soon\nagent: {id: 3000}\n")
    done = agent.reload()
    assert (done.returncode, done.stdout) == (78, "")
    assert f"{agent.file}:1: interval" in done.stderr and f"{agent.file}:2: agent.id" in done.stderr
    assert "the old configuration remains active" in done.stderr
    seen = json.loads(agent.reload("--json").stdout)
    assert (seen["ok"], [each["line"] for each in seen["problems"]]) == (False, [1, 2])
    assert agent.status()["boot_id"] == boot
    assert agent.status()["interval_s"] == 2.0
    assert control.ask(str(agent.folder / "run"), {"do": "ping"}) == "PHM is running"


def test_sighup_reloads(agent: Agent) -> None:
    """As `phm reload`, several times in succession, and a fault that a new limit ends is closed."""
    agent.process.send_signal(signal.SIGHUP)
    agent.write(interval="3s")
    agent.process.send_signal(signal.SIGHUP)
    until(lambda: agent.status().get("interval_s") == 3.0, "the first reload")
    agent.write(interval="4s", host={"disk": {"warn": 100, "error": 100}})
    agent.process.send_signal(signal.SIGHUP)
    until(lambda: agent.status().get("interval_s") == 4.0, "the second reload")
    until(lambda: agent.status() and agent.faults() == 0, "the end of the fault")
    assert agent.process.poll() is None


def test_an_unchanged_configuration_replaces_nothing(agent: Agent) -> None:
    """Reloading the same configuration keeps all components."""
    boot = agent.status()["boot_id"]
    done = agent.reload()
    assert (done.returncode, done.stdout) == (0, "configuration reloaded: no changes\n")
    assert agent.status()["boot_id"] == boot


def test_a_reload_waits_for_a_stop_by_hand_and_for_a_requested_restart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new daemon would not know of either. The reason is reported."""
    folders = {"state_dir": str(tmp_path / "s"), "run_dir": str(tmp_path / "r"), "log": {"directory": str(tmp_path)}}
    old = settings(
        containers=[{"name": "app", "recover": True}], docker={"socket": f"unix://{tmp_path}/none"}, **folders
    )
    daemon = build_daemon(old)
    wanted = old.model_copy(update={"interval": 3.0})
    reloader, notes = (
        Reloader(lambda: Configuration("", wanted, {}, CheckPlan((), (), DependencyGraph({})))),
        list[str](),
    )
    monkeypatch.setattr(daemon.pipeline, "note", lambda kind, text: notes.append(text))
    kill = DockerEvent("container", "app", "kill", "signal 15", daemon.clock.stamp(), end_s=10.0)
    daemon.components.docker_events.apply(kill)
    assert reloader.run(daemon) is daemon
    assert "app received a stop signal and has not exited yet: reload again when it has" in notes[-1]
    daemon.pipeline.container_ended("app")
    for event in ("die", "stop"):
        daemon.components.holds.happened("app", event, "")
    assert reloader.run(daemon) is daemon
    assert "an operator may be stopping app: reload again in 3 s" in notes[-1]
    daemon.components.holds.happened("app", "start", "")
    monkeypatch.setattr(OperatorRequests, "next", lambda requests: None)  # it stays as it is
    monkeypatch.setattr(OperatorRequests, "end", lambda requests: None)
    daemon.components.executor.restart("app", "the test")
    assert reloader.run(daemon) is daemon
    assert "an action is in progress (restart of app): reload again when it is finished" in notes[-1]
    daemon.components.executor.stop()


def test_cyclic_dependencies_are_rejected(agent: Agent) -> None:
    """A problem that only shows while the new daemon is built changes nothing either."""
    agent.write(
        checks={"files": {"needs": ["devices"]}, "devices": {"needs": ["files"]}},
        containers=[{"name": "app", "files": [{"path": "/x"}], "devices": [{"path": "/dev/null"}]}],
    )
    done = agent.reload()
    assert done.returncode in (1, 78), done
    assert "cycle" in done.stderr
    assert control.ask(str(agent.folder / "run"), {"do": "ping"}) == "PHM is running"


def test_reload_without_a_daemon_is_an_error(tmp_path: Path) -> None:
    """One message, exit code 1."""
    done = subprocess.run(
        [sys.executable, "-m", "phm.cli", "reload", "--run-dir", str(tmp_path)],
        text=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=LIMIT_S,
        check=False,
    )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "PHM is not running" in done.stderr


def _more(found: Callable[[], tuple[str, Any]], than: int) -> bool:
    return (found()[1] or 0) > than


def test_a_log_is_followed_over_a_reload(agent: Agent) -> None:
    """Of lines that are written meanwhile none is lost, none counts twice, and what was found stays a failure. Another log begins at its end."""
    log, written, stop = agent.folder / "app.log", [0], threading.Event()
    log.write_text("old FATAL\n")

    def checks(path: Path) -> list[dict[str, Any]]:
        pattern = {"patterns": [{"pattern": "FATAL"}], "quiet": "1h", "period": "500ms", "timeout": "60s"}
        return [{"name": "app", "type": "log", "path": str(path), **pattern}]

    def write() -> None:
        with log.open("a", buffering=1) as stream:
            while not stop.wait(0.01):
                stream.write("FATAL\n")
                written[0] += 1

    def found() -> tuple[str, Any]:
        unit: dict[str, Any] = next(
            (unit for unit in agent.status().get("checks", ()) if unit["id"] == "custom/app"), {}
        )
        return unit.get("level", ""), unit.get("values", {}).get("matches")

    agent.write(custom=checks(log))
    assert agent.reload().returncode == 0
    until(lambda: found() == ("OK", None), "the log to be followed", found)
    writer = threading.Thread(target=write)
    writer.start()
    try:
        for interval_s in (3.0, 4.0):
            until(partial(_more, found, written[0]), "lines to be found", found)
            agent.write(custom=checks(log), interval=f"{interval_s:g}s")
            assert agent.reload().returncode == 0
    finally:
        stop.set()
        writer.join()
    until(lambda: found() == ("ERROR", written[0]), f"all {written[0]} lines to be found", found)
    events = [each for each in json_log.read(agent.folder / "log") if each.get("unit") == "custom/app"]
    assert not [each for each in events if each["event"] == "fault_closed"]
    other = agent.folder / "other.log"
    other.write_text("FATAL of another file\n")
    agent.write(custom=checks(other))
    assert agent.reload().returncode == 0
    until(lambda: found() == ("OK", None), "another log to begin at its end", found)
