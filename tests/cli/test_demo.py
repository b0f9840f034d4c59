"""`phm demo` works as the README promises: without Docker, and no process or file is left behind."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from phm.simulation.demo import Demo, DemoPorts

SECONDS = 25
LIMIT_S = 120


def free_base() -> int:
    """A port below a range of free ones, most likely."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return min(port, 64900)


@pytest.mark.long
def test_three_agents_report_to_the_ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = free_base()
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    words = ["--for", str(SECONDS), "--first-port", str(base), "--ground-port", str(base + 25), "--web", "0"]
    done = subprocess.run(
        [sys.executable, "-m", "phm.cli", "demo", *words], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "page at http://127.0.0.1:" in done.stderr
    for agent in ("A01", "A02", "A03"):
        assert f"{agent} ACTIVE" in done.stdout or f"{agent} OK" in done.stdout
    commands = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, timeout=10, check=True).stdout
    assert f"127.0.0.1:{base + 1}" not in commands
    assert list(tmp_path.iterdir()) == []


def test_faults_are_injected_once_and_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []
    sleeper = [sys.executable, "-c", "import time; time.sleep(60)"]

    def spawn(self: Demo, name: str, words: list[str], environment: dict[str, str]) -> subprocess.Popen[bytes]:
        started.append(name)
        return subprocess.Popen(sleeper)

    monkeypatch.setattr(Demo, "_spawn", spawn)
    demo = Demo(tmp_path, DemoPorts())
    demo.start()
    try:
        before = list(started)
        demo.step(17.9)
        demo.step(28.0)
        assert started == before
        assert demo._autopilots[2].poll() is not None
        assert demo._daemons[3].wait(10) != 0
        assert demo._daemons[2].poll() is None
        demo.step(40.0)
        demo.step(41.0)
        assert started == [*before, "autopilot2"]
    finally:
        demo.close()
    assert all(process.poll() is not None for process in (*demo._autopilots.values(), *demo._daemons.values()))
