"""Receive signals as bytes from a socket: the handlers do nothing, so they cannot block on a lock that the interrupted code holds.

A handler runs in the main thread, between two bytecode instructions. A handler that calls `Event.set` deadlocks if the main thread
is inside `wait` of the same event, because `wait` holds the event's lock. So Python's C-level handler writes the number of each
signal into a socket (`signal.set_wakeup_fd`), and the thread that waits for signals reads it.
"""

from __future__ import annotations

import contextlib
import signal
import socket
from collections.abc import Callable
from types import FrameType, TracebackType

from phm.core import polling

Handler = Callable[[int, "FrameType | None"], None]


def _nothing(number: int, frame: FrameType | None) -> None:
    """Do nothing: the number of the signal is written to the socket."""


class Signals:
    """Handles these signals until `close`. Create and close it in the main thread; any single thread may read."""

    def __init__(self, *numbers: signal.Signals, handler: Handler = _nothing) -> None:
        """handler: also called, in the main thread; it must neither wait nor take a lock."""
        # Not a pipe: Windows takes only sockets.
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)
        self._wakeup = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, handler) for number in numbers}

    def wait(self, timeout_s: float | None) -> tuple[signal.Signals, ...]:
        """Wait at most `timeout_s` for signals and return them in order of arrival; empty after a timeout."""
        if not polling.wait([(self._read.fileno(), polling.READ)], None if timeout_s is None else max(0.0, timeout_s)):
            return ()
        with contextlib.suppress(BlockingIOError):
            data = self._read.recv(512)
            return tuple(number for number in map(signal.Signals, data) if number in self._before)
        return ()

    def close(self) -> None:
        """Restore the previous handlers of the signals."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        self._read.close()
        self._write.close()

    def __enter__(self) -> Signals:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
