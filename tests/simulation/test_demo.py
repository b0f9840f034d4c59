"""The processes of `phm demo` end with it, however it ends."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

from tests.fakes.until import until

STARTER = (
    "import sys, time; from pathlib import Path; from phm.simulation.demo import DemoAgents, DemoPorts\n"
    "agents = DemoAgents(Path(sys.argv[1]), DemoPorts(int(sys.argv[2]), 9))\n"
    "agents.start_autopilot(1); print(agents._autopilots[1].pid, flush=True); time.sleep(600)"
)
"""Prints the process id of an autopilot."""


def test_an_agent_ends_with_a_killed_demo(tmp_path: Path) -> None:
    """SIGKILL leaves the demo no time to end its agents."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        words = [sys.executable, "-c", STARTER, str(tmp_path), str(free.getsockname()[1] - 1)]
    demo = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert demo.stdout is not None
    with demo.stdout:
        autopilot = int(demo.stdout.readline())
    try:
        assert Path(f"/proc/{autopilot}").exists()
        demo.kill()
        demo.wait()
        until(lambda: not Path(f"/proc/{autopilot}").exists(), "the end of the autopilot")
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(autopilot, signal.SIGKILL)
