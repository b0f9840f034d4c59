"""A ROS child that does not end is killed, and no zombie of it stays."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest

from phm.probes.ros import child_process
from phm.probes.ros.child_process import ChildProcess
from tests.fakes.until import until

LINGERING = (sys.executable, "-c", "import time; print('up', flush=True); time.sleep(600)")
"""It does not exit when its input is closed."""


def test_a_killed_child_that_ends_late_is_reaped(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM does not wait for it any longer, and reports so; the kernel keeps nothing of it once it has ended."""
    monkeypatch.setattr(child_process, "_REAP_S", 0.0)
    child = ChildProcess(LINGERING, os.environ, b"")
    child.end(grace_s=0.0)
    assert "killed" in child.exit_reason() or "SIGKILL" in child.exit_reason()
    until(lambda: not Path(f"/proc/{child.pid}").exists(), "its end")
    until(lambda: child.exit_code == -signal.SIGKILL, "the thread that took its exit code to keep it")
