"""Time is injected: intervals are monotonic, stamps are UTC, and tests own the clock."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from typing import Protocol

from phm import threads
from phm.model import Stamp
from phm.scheduling import Lateness, Monitor

STEP_S = 1.0
"""UTC that has moved by more than this against the monotonic clock was set, and not slewed."""
MAX_STEPS = 64


class Clock(Protocol):
    """What PHM needs of time. `phm.testing.FakeClock` is the other implementation."""

    def mono(self) -> float:
        """Seconds of a clock that never jumps."""

    def utc(self) -> float:
        """Seconds since the epoch; may jump when the clock is set."""

    def stamp(self) -> Stamp:
        """Both at one moment."""

    def age_s(self, utc: float) -> float | None:
        """Seconds since something was stamped `utc` by this machine's clock: see `Steps.age_s`."""

    def late_s(self, since: float, most_s: float | None = None) -> float:
        """Seconds since `since` (monotonic) in which PHM itself did not get to run: see `Lateness.late_s`."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        """Wait until `event` is set or `timeout_s` has passed on the monotonic clock; True when set."""


@dataclass(slots=True)
class _Period:
    """From `begin` to `end` (monotonic seconds), UTC was `offset` ahead of the monotonic clock."""

    offset: float
    begin: float
    end: float


@dataclass(slots=True)
class Steps:
    """The steps of the UTC clock that were seen since boot. `note` is to be called often. Not thread-safe.

    Invariant: periods follow each other without a gap; the first begins at boot, where the monotonic clock is 0.
    """

    periods: list[_Period] = field(default_factory=list)

    def note(self, now: Stamp) -> None:
        offset = now.utc - now.mono
        if self.periods and abs(offset - self.periods[-1].offset) <= STEP_S:
            self.periods[-1].end = now.mono
            return
        begin = self.periods[-1].end if self.periods else 0.0
        self.periods.append(_Period(offset, begin, now.mono))
        if len(self.periods) > MAX_STEPS:
            del self.periods[1]
            self.periods[1].begin = self.periods[0].end

    def age_s(self, utc: float, now: Stamp) -> float | None:
        """Seconds since something was stamped `utc`, the least of what is possible; None when nothing is.

        The stamp may be of any period since boot, under the clock as it was then, or older than the boot: an age is never
        made longer by a step of the clock in between.
        """
        self.note(now)
        moments = [utc - period.offset for period in self.periods]
        possible = [
            now.mono - moment
            for moment, period in zip(moments, self.periods, strict=True)
            if period.begin - STEP_S <= moment <= period.end + STEP_S
        ]
        if now.utc - utc > now.mono:
            possible.append(now.utc - utc)  # from before the boot
        return max(0.0, min(possible)) if possible else None


class SystemClock:
    """The machine's clocks. CLOCK_MONOTONIC, as `time.monotonic` uses on Linux. Thread-safe.

    lateness: of this process, as far as a `phm.scheduling.Monitor` measures it.
    """

    def __init__(self) -> None:
        self.lateness = Lateness()
        self._steps, self._lock = Steps(), threading.Lock()

    def measure(self) -> None:
        """Begin to measure how late PHM is, once for a process: until its end."""
        threads.start(Monitor(self.lateness).thread)

    def mono(self) -> float:
        return time.monotonic()

    def utc(self) -> float:
        return time.time()

    def stamp(self) -> Stamp:
        with self._lock:  # stamps that overtake each other would look like a clock that was set
            stamp = Stamp(utc=time.time(), mono=time.monotonic())
            self._steps.note(stamp)
        return stamp

    def age_s(self, utc: float) -> float | None:
        stamp = self.stamp()
        with self._lock:
            return self._steps.age_s(utc, stamp)

    def late_s(self, since: float, most_s: float | None = None) -> float:
        return self.lateness.late_s(since, time.monotonic(), most_s)

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        return event.wait(timeout_s)
