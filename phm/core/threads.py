"""Start threads even at a process limit.

At a limit (`pids_limit` of a container, `ulimit -u`) `Thread.start` raises RuntimeError. Such a thread waits here, `retry` starts
it later, and `problem` reports it meanwhile.
"""

from __future__ import annotations

import contextlib
import threading
import time

REPORTED_S = 12.0
"""How long a thread for a single task that could not be started is reported; its owner retries the task."""

_COMM = 15
"""Bytes of a name that the kernel keeps."""

_lock = threading.Lock()
_waiting: list[threading.Thread] = []
_refused: dict[str, float] = {}


def start(thread: threading.Thread) -> bool:
    """Start it now, or later by `retry`. Return whether it is running. For threads that run until PHM ends."""
    if _started(thread):
        return True
    with _lock:
        _waiting.append(thread)
    return False


def start_now(thread: threading.Thread) -> bool:
    """Start it now or not at all. For a single task that its owner retries."""
    if _started(thread):
        return True
    with _lock:
        _refused[thread.name] = time.monotonic()
    return False


def join(thread: threading.Thread, timeout_s: float) -> bool:
    """Wait for its end. Return whether it has ended or never started."""
    if thread.ident is not None and thread is not threading.current_thread():
        thread.join(max(0.0, timeout_s))
    return not thread.is_alive()


def retry() -> None:
    """Start waiting threads, as far as the system allows."""
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
    return f"threads cannot be started ({shown}): raise the process limit, e.g. pids_limit of PHM's container"


def _started(thread: threading.Thread) -> bool:
    """Raises RuntimeError for a thread that was started before, as `Thread.start` does."""
    before = thread.ident
    try:
        thread.start()
    except RuntimeError:
        if before is not None or thread.ident is not None:
            raise
        return False
    _show_name(thread)
    return True


def _show_name(thread: threading.Thread) -> None:
    """Give the kernel its name too, so that `top -H` and /proc show which thread costs what. Python does so from 3.14 on."""
    with contextlib.suppress(OSError), open(f"/proc/self/task/{thread.native_id}/comm", "wb", buffering=0) as stream:
        stream.write(thread.name.removeprefix("phm-").encode("ascii", "replace")[:_COMM])
