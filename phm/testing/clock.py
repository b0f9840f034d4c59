"""A clock that the test moves."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable

from phm.core.clock import ClockSteps
from phm.core.model import Stamp
from phm.core.scheduling_delay import SchedulingDelay

# How often `wait_for_sleepers` asks a function for its count (real seconds).
_POLL_S = 0.002


@dataclasses.dataclass(eq=False)
class _Sleeper:
    event: threading.Event
    until: float | None

    @property
    def changed(self) -> threading.Condition:
        """The event's own condition: no other wait is woken by the event, set by any thread, as well as by the clock."""
        condition: threading.Condition = self.event._cond  # type: ignore[attr-defined]
        return condition


class FakeClock:
    """A `phm.core.clock.Clock` that changes only when the test moves it.

    Invariant: a thread counts as sleeping only while neither its event is set nor its time is over, so
    that after `advance` a `wait_for_sleepers` waits for the woken threads to have done their work.
    """

    def __init__(self, mono: float = 1000.0, utc: float = 1_700_000_000.0) -> None:
        self._mono = mono
        self._utc = utc
        self.steps = ClockSteps()
        self.steps.note(Stamp(utc, mono))
        self._lateness = SchedulingDelay()
        self._sleepers: list[_Sleeper] = []
        self._slept = threading.Condition(threading.RLock())

    def mono(self) -> float:
        with self._slept:
            return self._mono

    def utc(self) -> float:
        with self._slept:
            return self._utc

    def stamp(self) -> Stamp:
        with self._slept:
            return Stamp(utc=self._utc, mono=self._mono)

    def latest(self, utc: float) -> float:
        return self.steps.latest(utc)

    def advance(self, seconds: float) -> None:
        """Move both clocks forward and wake the threads whose time has come."""
        if seconds < 0:
            raise ValueError("the monotonic clock never goes back: use jump_utc")
        with self._slept:
            self._mono += seconds
            self._utc += seconds
            self.steps.note(Stamp(self._utc, self._mono))
            due = [sleeper for sleeper in self._sleepers if not self._asleep(sleeper)]
        for sleeper in due:  # the others sleep on: a test moves the clock thousands of times
            with sleeper.changed:
                sleeper.changed.notify_all()

    def be_late(self, seconds: float) -> None:
        """Move both clocks as `advance` does, while PHM does not run: time that `late_s` reports."""
        self._lateness.expect(self.mono())
        self.advance(seconds)
        self._lateness.record_run(self.mono())

    def late_s(self, since: float, most_s: float | None = None) -> float:
        return self._lateness.late_s(since, self.mono(), most_s)

    def jump_utc(self, seconds: float) -> None:
        """Set UTC forward or back, as an NTP client does; no sleeper wakes."""
        with self._slept:
            self._utc += seconds
            self.steps.note(Stamp(self._utc, self._mono))

    @property
    def sleepers(self) -> int:
        """How many threads wait now for time or for their event."""
        with self._slept:
            return self._count()

    def wait_for_sleepers(self, count: int | Callable[[], int], timeout_s: float = 60.0) -> None:
        """Block, in real time, until at least `count` threads wait; TimeoutError when they do not come.

        A function is asked for the count each time, as the woken threads may change it.
        """
        limit = time.monotonic() + timeout_s
        with self._slept:
            while self._count() < (expected := count() if callable(count) else count):
                if time.monotonic() >= limit:
                    raise TimeoutError(f"{self._count()} threads wait on the fake clock, expected {expected}")
                self._slept.wait(_POLL_S)

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        """As `phm.core.clock.Clock.wait`, in the time of this clock."""
        with self._slept:
            sleeper = _Sleeper(event, None if timeout_s is None else self._mono + timeout_s)
            self._sleepers.append(sleeper)
            self._slept.notify_all()
        try:
            with sleeper.changed:
                sleeper.changed.wait_for(lambda: not self._asleep(sleeper))
            return event.is_set()
        finally:
            with self._slept:
                self._sleepers.remove(sleeper)

    def _asleep(self, sleeper: _Sleeper) -> bool:
        return not sleeper.event.is_set() and (sleeper.until is None or sleeper.until > self._mono)

    def _count(self) -> int:
        return sum(1 for sleeper in self._sleepers if self._asleep(sleeper))
