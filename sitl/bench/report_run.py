"""One call of `phm report` as a user makes it: its time, and the memory of all its processes together."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import psutil

LIMIT_S = 7200.0
POLL_S = 0.2
ROOT = Path(__file__).resolve().parents[2]


def run(arguments: Sequence[str], output: int) -> tuple[float, int]:
    """Seconds, and the most memory in bytes (proportional set size, asked five times a second). output: a file descriptor for what it
    prints. Raises SystemExit if it fails, or takes longer than LIMIT_S."""
    paths = os.pathsep.join((str(ROOT), str(ROOT / "checks")))
    argv = [sys.executable, "-m", "phm.cli", "report", *arguments]
    began, most = time.monotonic(), 0
    process = subprocess.Popen(argv, stdout=output, env={**os.environ, "PYTHONPATH": paths})
    try:
        while process.poll() is None:
            most = max(most, _memory(process.pid))
            if time.monotonic() - began > LIMIT_S:
                raise SystemExit(f"phm report took more than {LIMIT_S:g} s")
            try:
                process.wait(POLL_S)
            except subprocess.TimeoutExpired:
                continue
    finally:
        process.kill()
        process.wait()
    if process.returncode:
        raise SystemExit(f"phm report ended with {process.returncode}")
    return time.monotonic() - began, most


def _memory(pid: int) -> int:
    """Of the process and its children, in bytes."""
    total = 0
    try:
        parent = psutil.Process(pid)
        for each in [parent, *parent.children(recursive=True)]:
            total += each.memory_full_info().pss
    except (psutil.Error, OSError):
        pass  # one has just ended
    return total
