"""Signals as bytes to be read: their handlers do nothing, so they find nothing that the interrupted code holds.

A handler runs in the main thread, between two steps of whatever that is doing. One that calls `Event.set` stops for ever when the
main thread is inside `wait` of that same event, which holds the event's lock. The kernel's part of Python writes each signal's
number into a pipe instead (`signal.set_wakeup_fd`), and the thread that waits for signals reads it.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable
from types import FrameType, TracebackType

Handler = Callable[[int, "FrameType | None"], None]


def _nothing(number: int, frame: FrameType | None) -> None:
    """The number is in the pipe."""


class Signals:
    """Takes these signals over until `close`; to be made and closed by the main thread, read by any one thread."""

    def __init__(self, *numbers: signal.Signals, handler: Handler = _nothing) -> None:
        """handler: is called as well, in the main thread; it must neither wait nor take a lock."""
        self._read, self._write = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._before = {number: signal.signal(number, handler) for number in numbers}

    def wait(self, timeout_s: float | None) -> tuple[signal.Signals, ...]:
        """Those that came, in their order, at most `timeout_s` from now; empty when none did."""
        ready = select.poll()
        ready.register(self._read, select.POLLIN)
        if not ready.poll(None if timeout_s is None else max(0.0, timeout_s) * 1000):
            return ()
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._read, 512)
            return tuple(number for number in map(signal.Signals, data) if number in self._before)
        return ()

    def close(self) -> None:
        """Give the signals back to whom they belonged before."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._wakeup)
        os.close(self._read)
        os.close(self._write)

    def __enter__(self) -> Signals:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
