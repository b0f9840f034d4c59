"""Ends programs that were started in their own session, with their children."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading

from phm.core import threads

REAP_S = 1.0
"""A killed program that has not ended after this time hangs in the kernel, or the machine is too busy."""


def kill(group: int) -> None:
    """group: the id of its program, which is not reaped yet, so that the number is still its own."""
    with contextlib.suppress(OSError):
        os.killpg(group, signal.SIGKILL)


def end(program: subprocess.Popen[bytes]) -> bool:
    """Kill the program and its children. Waits at most REAP_S; returns whether the program has ended."""
    kill(program.pid)
    try:
        program.wait(REAP_S)
    except subprocess.TimeoutExpired:  # no zombie stays
        threads.start_now(threading.Thread(target=program.wait, name="phm-reap", daemon=True))
        return False
    return True
