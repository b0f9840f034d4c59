"""PHM's own priority: it is set if permitted, and otherwise reported without harm."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from phm.core.process_priority import apply
from phm.core.settings import ProcessSettings

INHERITED = """
import os, sys, threading
from phm.core.process_priority import apply
from phm.core.settings import ProcessSettings
found = apply(ProcessSettings(nice=int(sys.argv[1])))
seen = []
thread = threading.Thread(target=lambda: seen.append(os.getpriority(os.PRIO_PROCESS, 0)))
thread.start(), thread.join()
print(found.nice, seen[0], found.problem)
"""
CHILD = """
from phm.probes.ros.child import _go_first
own = lambda: int(open("/proc/self/oom_score_adj").read())
before = own()
_go_first()
print(min(1000, before + 500) == own())
"""


def run(script: str, *words: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_threads_that_are_started_later_inherit_it() -> None:
    """It is set before there are threads: main loop, links and the ROS child process inherit it."""
    nice = min(19, os.getpriority(os.PRIO_PROCESS, 0) + 1)
    assert run(INHERITED, str(nice)) == f"{nice} {nice}"


def test_a_denied_priority_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM runs on with its current priority and says what to do."""

    def refuse(which: int, who: int, nice: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    found = apply(ProcessSettings(nice=-10))
    assert found.nice == os.getpriority(os.PRIO_PROCESS, 0)
    assert "process.nice -10 is not permitted" in found.problem
    assert "ulimits: {nice: 30}" in found.problem


def test_by_default_nothing_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A priority from outside is kept."""
    monkeypatch.setattr(os, "setpriority", None)
    assert apply(ProcessSettings()).problem == ""


def test_the_ros_child_is_killed_first_when_memory_runs_out() -> None:
    """The daemon replaces it; only Docker replaces the daemon."""
    assert run(CHILD) == "True"
