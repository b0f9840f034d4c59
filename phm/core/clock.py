"""The clock: intervals are monotonic, time stamps are UTC. Tests inject a fake clock."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from phm.core import threads
from phm.core.model import Stamp
from phm.core.scheduling_delay import DelayMonitor, SchedulingDelay

STEP_S = 1.0
"""A UTC change by more than this relative to the monotonic clock is a step; smaller ones are slew."""
MAX_STEPS = 64
UNWATCHED_S = 5.0
"""After a longer time without observation there may have been several steps, so earlier offsets are discarded."""


class Clock(Protocol):
    """Interface of the clock. `phm.testing.FakeClock` implements it for tests."""

    def mono(self) -> float:
        """Seconds of a clock that never jumps."""

    def utc(self) -> float:
        """Seconds since the epoch; may jump when the clock is set."""

    def stamp(self) -> Stamp:
        """Both clocks, read at the same moment."""

    def latest(self, utc: float) -> float:
        """The latest monotonic moment at which this machine's clock can have created the time stamp `utc`: see
        `ClockSteps.latest`."""

    @property
    def steps(self) -> ClockSteps:
        """Steps of the UTC clock."""

    def late_s(self, since: float, most_s: float | None = None) -> float:
        """Seconds since `since` (monotonic) in which PHM was not scheduled: see `SchedulingDelay.late_s`."""

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        """Wait until `event` is set or `timeout_s` has passed on the monotonic clock; True when set."""


@dataclass(slots=True)
class _Period:
    """From `begin` to `end` (monotonic seconds), UTC was `offset` ahead of the monotonic clock."""

    offset: float
    begin: float
    end: float

    def holds(self, utc: float) -> bool:
        """Whether a time stamp `utc` can be from this period."""
        return self.begin - STEP_S <= utc - self.offset <= self.end + STEP_S


class ClockSteps:
    """Steps of the UTC clock since observation began. Thread-safe.

    Earlier steps are unknown: without a battery-backed clock a computer starts in 1970 or at the time of its last shutdown.
    Invariant: periods are contiguous.
    """

    def __init__(self) -> None:
        self._periods: list[_Period] = []
        self._lock = threading.Lock()

    def note(self, now: Stamp) -> None:
        """Observe the clock; call it often, in the order of the stamps."""
        offset = now.utc - now.mono
        with self._lock:
            last = self._periods[-1] if self._periods else None
            if last is not None and abs(offset - last.offset) <= STEP_S:
                last.end = now.mono
                return
            if last is None or now.mono - last.end > UNWATCHED_S:
                self._periods = [_Period(offset, now.mono, now.mono)]
                return
            self._periods.append(_Period(offset, last.end, now.mono))
            del self._periods[:-MAX_STEPS]

    def known_since(self) -> float:
        """Since when (monotonic seconds) every step of the clock is known. `note` must have been called."""
        with self._lock:
            return self._periods[0].begin

    def latest(self, utc: float) -> float:
        """The latest moment (monotonic seconds) at which the time stamp `utc` can have been created.

        So a clock step never makes an age longer, and a time stamp from before the observation is at most as old as the
        observation. Call `note` after reading the time stamp.
        """
        with self._lock:
            possible = [utc - period.offset for period in self._periods if period.holds(utc)]
            return max(possible, default=self._periods[0].begin)

    def kept(self) -> tuple[tuple[float, float], ...]:
        """For a later PHM: offset and beginning of each period."""
        with self._lock:
            return tuple((period.offset, period.begin) for period in self._periods)

    def resume(self, kept: Iterable[tuple[float, float]]) -> None:
        """Continue from the periods that an earlier PHM has `kept` since the machine booted. They count only if UTC has
        not moved since: otherwise it was set while no PHM ran."""
        with self._lock:
            first, before = self._periods[0], sorted(kept, key=lambda each: each[1])
            if not (
                before
                and abs(before[-1][0] - first.offset) <= STEP_S
                and 0 <= before[0][1] <= before[-1][1] <= first.begin
            ):
                return
            ends = [begin for _, begin in before[1:]]
            earlier = [_Period(*each, end) for each, end in zip(before, ends, strict=False)]
            first.offset, first.begin = before[-1]
            self._periods = [*earlier, *self._periods][-MAX_STEPS:]


class SystemClock:
    """The machine's clocks. CLOCK_MONOTONIC, as `time.monotonic` uses on Linux. Thread-safe.

    lateness: of this process, measured by a `phm.core.scheduling_delay.DelayMonitor`.
    """

    def __init__(self) -> None:
        self.lateness = SchedulingDelay()
        self.steps, self._lock = ClockSteps(), threading.Lock()
        self.stamp()

    def measure(self) -> None:
        """Start measuring how late PHM is, once per process, until it ends."""
        threads.start(DelayMonitor(self.lateness).thread)

    def mono(self) -> float:
        return time.monotonic()

    def utc(self) -> float:
        return time.time()

    def stamp(self) -> Stamp:
        with self._lock:  # time stamps out of order would look like a clock that was set
            stamp = Stamp(utc=time.time(), mono=time.monotonic())
            self.steps.note(stamp)
        return stamp

    def latest(self, utc: float) -> float:
        self.stamp()  # a step of this moment must be known
        return self.steps.latest(utc)

    def late_s(self, since: float, most_s: float | None = None) -> float:
        return self.lateness.late_s(since, time.monotonic(), most_s)

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        return event.wait(timeout_s)
