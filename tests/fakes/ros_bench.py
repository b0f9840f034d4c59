"""Real nodes and a real child process, on loopback, each test in its own ROS domain."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from phm.core.clock import SystemClock
from phm.core.settings import Settings
from phm.facts import CannotTell, RosFact
from phm.probes.ros.supervisor import COMMAND, RosSupervisor, SupervisorLimits
from sitl.bench.ros_environments import server_command
from tests.fakes import until as wait
from tests.fakes.ros_domain import claim_domain

ROOT = Path(__file__).resolve().parents[2]
LIMITS = SupervisorLimits()
_open: list[Bench] = []
"""What a test that fails for want of something describes."""


def until(condition: Callable[[], Any], what: str, limit_s: float = 60.0) -> Any:
    """`tests.fakes.until.until` with the state of all benches in the message."""
    return wait.until(condition, what, lambda: "\n".join(bench.state() for bench in _open), limit_s=limit_s)


class Bench:
    """Starts application nodes and probes in one private domain, and ends them all."""

    def __init__(self) -> None:
        self.domain, lock = claim_domain()
        self.environ = {
            **os.environ,
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(self.domain),
            "PYTHONPATH": str(ROOT),
        }
        self.notes: list[str] = []
        self.changes = 0
        self.on_change: Callable[[], object] = lambda: None
        self._probes: list[RosSupervisor] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        self._closing = contextlib.ExitStack()
        self._closing.callback(lock.close)
        _open.append(self)
        self._closing.callback(_open.remove, self)

    def node(
        self, name: str, *arguments: str, module: str = "sitl.application.node", before: Sequence[str] = ()
    ) -> subprocess.Popen[bytes]:
        """A demo node in /agent_1 with the shipped short-lease profile. before: what its command line begins with."""
        environ = {**self.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(ROOT / "config" / "fastdds.xml")}
        command = [*before, sys.executable, "-m", module, "--name", name, "--namespace", "/agent_1", *arguments]
        return self._keep(subprocess.Popen(command, env=environ))

    def discovery_server(self) -> str:
        """A Fast DDS discovery server on loopback; its address, as ROS_DISCOVERY_SERVER takes it."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        command = server_command(Path(sys.executable).parent, "127.0.0.1", port)
        self._keep(subprocess.Popen(command, env=self.environ, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL))
        return f"127.0.0.1:{port}"

    def source(self, hz: float, path: Path) -> None:
        """A publisher that writes its publications to `path`; see `ros_source`."""
        script = ROOT / "tests" / "fakes" / "ros_source.py"
        self._keep(subprocess.Popen([sys.executable, str(script), str(hz), str(path)], env=self.environ))

    def script(self, name: str, *arguments: str) -> subprocess.Popen[bytes]:
        """A script of tests/fakes, with pipes to its standard input and output."""
        command = [sys.executable, str(ROOT / "tests" / "fakes" / name), *arguments]
        return self._keep(subprocess.Popen(command, env=self.environ, stdin=subprocess.PIPE, stdout=subprocess.PIPE))

    def probe(
        self,
        topics: Sequence[Mapping[str, Any]] = (),
        *,
        command: Sequence[str] = COMMAND,
        limits: SupervisorLimits = LIMITS,
        environ: Mapping[str, str] | None = None,
        custom: Sequence[Mapping[str, Any]] = (),
        **ros: Any,
    ) -> RosSupervisor:
        settings = Settings.model_validate(
            {"ros": {"topics": list(topics), "domain": self.domain, **ros}, "custom": list(custom)}
        )
        merged = {**self.environ, **(environ or {})}
        probe = RosSupervisor(
            settings.ros,
            settings.agent.name,
            SystemClock(),
            self._changed,
            self.notes.append,
            merged,
            command=command,
            limits=limits,
            custom=settings.custom,
        )
        self._probes.append(probe)
        self._closing.callback(probe.close)
        probe.start()
        return probe

    def state(self) -> str:
        """The state for the message of a failed test: domain, processes, what each probe knows and why it knows no more."""
        lines = [f"ROS domain {self.domain}; /dev/shm has {len(os.listdir('/dev/shm'))} files; notes: {self.notes}"]
        for process in self._processes:
            code = process.poll()
            lines.append(f"process {process.pid} {'runs' if code is None else f'ended with {code}'}: {process.args!r}")
        for probe in self._probes:
            child = f"runs as {probe.pid}" if probe.pid and not gone(probe.pid) else "does not run"
            lines.append(f"a probe, whose child {child}, after {probe.restarts} restarts; problems: {probe.problems()}")
            try:
                lines.append(f"    its picture: {probe.snapshot()}")
            except CannotTell as error:
                lines.append(f"    it cannot tell: {error}")
        return "\n".join(lines)

    def _keep(self, process: subprocess.Popen[bytes]) -> subprocess.Popen[bytes]:
        self._processes.append(process)
        self._closing.callback(_end, process)
        return process

    def _changed(self) -> None:
        self.changes += 1
        self.on_change()

    def close(self) -> None:
        self._closing.close()


class Listener:
    """A real subscriber of diagnostic arrays; `received` is the newest of each status, as [level, message, hardware id, values]."""

    def __init__(self, bench: Bench, topic: str = "/diagnostics") -> None:
        self.received: dict[str, list[Any]] = {}
        self.frames: dict[str, str] = {}
        process = bench.script("ros_status.py", "receive", "monitor", topic)
        threading.Thread(target=self._read, args=(process,), daemon=True).start()

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        with contextlib.suppress(ValueError):  # at the end of the test the pipe is closed, in the middle of a line
            for line in process.stdout:
                frame, statuses = json.loads(line)
                self.received.update({name: rest for name, *rest in statuses})
                self.frames.update({name: frame for name, *_ in statuses})


def seen(probe: RosSupervisor, condition: Callable[[RosFact], Any], what: str, limit_s: float = 60.0) -> Any:
    """Wait until a snapshot satisfies `condition`; ignores STALE moments."""

    def observe() -> Any:
        try:
            return condition(probe.snapshot())
        except CannotTell:
            return None

    return until(observe, what, limit_s)


def stale(probe: RosSupervisor) -> str:
    """The reason why the probe cannot tell, or an empty string when it can."""
    try:
        probe.snapshot()
    except CannotTell as error:
        return str(error)
    return ""


def gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def _end(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
