"""One deadline for a task with many parts, of which any may hang: an engine, a file system, a pipe that has the name of a file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class Late(Exception):
    """A part was not done in its time; the message says within how many seconds."""


class Deadline:
    """seconds: for everything. A part may have the time until a share of it is over, so that one does not cost all others."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self._begin = seconds, time.monotonic()

    def left(self, share: float = 1.0) -> float:
        """Seconds until this share of the time is over; not less than 0."""
        return max(0.0, self._begin + share * self.seconds - time.monotonic())

    def within(self, share: float, work: Callable[[], T]) -> T:
        """What `work` returns or raises. Raises Late: it goes on in its thread, so it must not change anything that others use."""
        seconds = self.left(share)
        if seconds <= 0:
            raise Late(f"not started within the time limit of {self.seconds:g} s")
        done: list[tuple[bool, Any]] = []

        def run() -> None:
            try:
                done.append((True, work()))
            except Exception as error:  # raised again below
                done.append((False, error))

        thread = threading.Thread(target=run, name="bundle-part", daemon=True)
        thread.start()
        thread.join(seconds)
        if not done:
            raise Late(f"not done within {seconds:.1f} s")
        good, result = done[0]
        if not good:
            raise result
        return result  # type: ignore[no-any-return]
