"""Threads that start as soon as the system lets them.

At a limit of processes (`pids_limit` of a container, `ulimit -u`) `Thread.start` raises RuntimeError. A part of PHM whose thread
is missing for that reason is not lost: its thread waits here, `retry` starts it later, and `problem` says so meanwhile.
"""

from __future__ import annotations

import threading
import time

REPORTED_S = 12.0
"""A thread for a single task that could not be made is reported for so long; its task is tried again by its owner."""

_lock = threading.Lock()
_waiting: list[threading.Thread] = []
_refused: dict[str, float] = {}


def start(thread: threading.Thread) -> bool:
    """Start it now, or else as soon as `retry` can; whether it runs already. For threads that serve until PHM ends."""
    if _started(thread):
        return True
    with _lock:
        _waiting.append(thread)
    return False


def start_now(thread: threading.Thread) -> bool:
    """Start it now or not at all: for a single task, whose owner tries again in its own time."""
    if _started(thread):
        return True
    with _lock:
        _refused[thread.name] = time.monotonic()
    return False


def join(thread: threading.Thread, timeout_s: float) -> bool:
    """Wait for its end; whether it has ended, or has never begun."""
    if thread.ident is not None and thread is not threading.current_thread():
        thread.join(max(0.0, timeout_s))
    return not thread.is_alive()


def retry() -> None:
    """Start what waits, as far as the system allows."""
    with _lock:
        waiting, _waiting[:] = list(_waiting), []
    for thread in waiting:
        start(thread)


def problem() -> str:
    """A sentence while threads are missing, else empty."""
    with _lock:
        now = time.monotonic()
        for name in [name for name, at in _refused.items() if now - at > REPORTED_S]:
            del _refused[name]
        names = list(dict.fromkeys([*(thread.name for thread in _waiting), *_refused]))
    if not names:
        return ""
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return f"threads cannot be started ({shown}): raise the limit of processes, e.g. pids_limit of PHM's container"


def _started(thread: threading.Thread) -> bool:
    """Raises RuntimeError for a thread that was started before, as `Thread.start` does."""
    before = thread.ident
    try:
        thread.start()
    except RuntimeError:
        if before is not None or thread.ident is not None:
            raise
        return False
    return True
