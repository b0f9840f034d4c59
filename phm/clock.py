"""Time is injected: intervals are monotonic, stamps are UTC, and tests own the clock."""

from __future__ import annotations

import threading
import time
from typing import Protocol

from phm.model import Stamp


class Clock(Protocol):
    """What PHM needs of time. `phm.testing.FakeClock` is the other implementation."""

    def mono(self) -> float:
        """Seconds of a clock that never jumps."""

    def utc(self) -> float:
        """Seconds since the epoch; may jump when the clock is set."""

    def stamp(self) -> Stamp:
        """Both at one moment."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        """Wait until `event` is set or `timeout_s` has passed on the monotonic clock; True when set."""


class SystemClock:
    """The machine's clocks. CLOCK_MONOTONIC, as `time.monotonic` uses on Linux."""

    def mono(self) -> float:
        return time.monotonic()

    def utc(self) -> float:
        return time.time()

    def stamp(self) -> Stamp:
        return Stamp(utc=time.time(), mono=time.monotonic())

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        return event.wait(timeout_s)
