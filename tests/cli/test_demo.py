"""`phm demo` works as the README promises: without Docker, and no process or file is left behind."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from phm.cli import demo as demo_verb
from phm.simulation import demo as demo_module
from phm.simulation.demo import Demo, DemoPorts

LIMIT_S = 300


def free_base() -> int:
    """A port below a range of free ones, most likely."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return min(port, 64900)


def options(base: int, seconds: int) -> list[str]:
    given = {"--for": seconds, "--first-port": base, "--ground-port": base + 25}
    return [str(word) for option in given.items() for word in option]


def words(base: int, seconds: int) -> list[str]:
    return [sys.executable, "-m", "phm.cli", "demo", *options(base, seconds), "--web", "0"]


def end_after_discovery(command: list[str], **more: Any) -> int:
    """Runs the demo until its ground has received all agents, then sends SIGINT. Returns the exit code."""
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **more)
    assert demo.stdout is not None
    waiting, lines = {f"A0{agent} discovered" for agent in (1, 2, 3)}, []
    try:
        for line in demo.stdout:  # its state is not the subject: it is CRITICAL where the machine's CPU is in use
            lines.append(line)
            waiting -= {text for text in waiting if text in line}
            if not waiting:
                break
        demo.send_signal(signal.SIGINT)
        demo.wait(LIMIT_S)
    finally:
        demo.kill()
        demo.stdout.close()
    assert not waiting, "".join(lines)
    return demo.returncode


def assert_nothing_left(base: int, folder: Path) -> None:
    commands = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, timeout=120, check=True).stdout
    assert f"127.0.0.1:{base + 1}" not in commands
    assert list(folder.iterdir()) == []


@pytest.mark.long
def test_three_agents_report_to_the_ground_until_ctrl_c(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Real daemons, autopilots and a ground; SIGINT ends them all."""
    base = free_base()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with (tmp_path.parent / "demo.err").open("w+") as errors:
        assert end_after_discovery(words(base, LIMIT_S), stderr=errors) == 0
        errors.seek(0)
        assert "page at http://127.0.0.1:" in errors.read()
    assert_nothing_left(base, tmp_path)


@pytest.mark.long
def test_the_demo_ends_after_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With exit code 0, without processes or files left."""
    base = free_base()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = subprocess.run(words(base, 1), capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    assert_nothing_left(base, tmp_path)


class SlowToEnd:
    """A ground station that needs ten seconds to end, in a time that the test makes up."""

    def __init__(self) -> None:
        self.left_s, self.killed = 10.0, False

    def poll(self) -> None:
        pass

    terminate = poll

    def kill(self) -> None:
        self.killed = True

    def wait(self, timeout: float | None = None) -> int:
        if timeout is not None and timeout < self.left_s:
            self.left_s -= timeout
            raise subprocess.TimeoutExpired("phm gcs", timeout)
        return -9 if self.killed else 0


def test_a_ground_station_on_a_busy_machine_is_not_killed() -> None:
    """It may take seconds to end: killed, it would make the demonstration fail."""
    station = SlowToEnd()
    assert demo_verb._stop(station) == 0  # type: ignore[arg-type]
    assert not station.killed


def test_faults_are_injected_once_and_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The autopilot of agent 2 and the PHM of agent 3 end, and nothing else."""
    started: list[str] = []
    sleeper = [sys.executable, "-c", "import time; time.sleep(600)"]

    def spawn(self: Demo, name: str, words: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        started.append(name)
        return subprocess.Popen(sleeper)

    monkeypatch.setattr(Demo, "_spawn", spawn)
    monkeypatch.setattr(demo_module, "_END_S", 60.0)
    demo = Demo(tmp_path, DemoPorts())
    demo.start()
    try:
        before = list(started)
        demo.step(17.9)
        demo.step(28.0)
        assert started == before
        assert demo._autopilots[2].poll() is not None
        assert demo._daemons[3].wait(60) != 0
        assert demo._daemons[2].poll() is None
        demo.step(45.0)
        demo.step(46.0)
        assert started == [*before, "autopilot2"]
    finally:
        demo.close()
    assert all(process.poll() is not None for process in (*demo._autopilots.values(), *demo._daemons.values()))
