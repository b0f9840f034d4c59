"""Measure how long PHM itself was not scheduled: silence during that time proves nothing about a sender.

A thread sleeps for a fixed period and measures how late it wakes, whatever the reason: stopped, frozen, throttled, swapped out
or waiting for a CPU. For another process the kernel's counters are read. Standard library only.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

PERIOD_S = 0.25
NOISE_S = 0.02
"""Smaller delays are ignored: timers, garbage collection, a time slice of another process."""
KEPT = 2048
"""Number of spans that are remembered: at least eight minutes if each period is late."""
WINDOW_S = 60.0
"""The window for the share that `phm status` shows."""

HELD = ("R", "D")
"""States of a process that would run if it could: ready, or waiting for a disk."""

Late = Callable[[float, float | None], float]
"""Like `SchedulingDelay.late_s` at the moment of the call: since when, and the maximum beside the longest span."""


def never_late(since: float, most_s: float | None = None) -> float:
    """A `Late` for callers without a measurement."""
    return 0.0


class SchedulingDelay:
    """Periods in which PHM was not scheduled. The caller passes the time; thread-safe.

    A thread that asks is running, so it closes the period that the measuring thread has not noticed yet: right after a pause all
    threads get the same answer.
    """

    def __init__(self) -> None:
        self._spans: deque[tuple[float, float]] = deque(maxlen=KEPT)
        self._due: float | None = None
        self._lock = threading.Lock()

    def expect(self, due: float) -> None:
        """The measuring thread will run again at `due`."""
        with self._lock:
            self._due = due

    def record_run(self, now: float) -> None:
        """Record that the measuring thread runs now."""
        with self._lock:
            self._notice(now)
            self._due = None

    def late_s(self, since: float, now: float, most_s: float | None = None) -> float:
        """Seconds between `since` and `now` in which PHM did not run.

        most_s: for a deadline of this many seconds. The longest span counts in full, all others together up to most_s: after a
        pause senders have as much time as before it, and if PHM is starved permanently a deadline is at most doubled.
        """
        with self._lock:
            self._notice(now)
            longest_s = total_s = 0.0
            for begin, end in reversed(self._spans):
                if end <= since:
                    break
                span_s = min(end, now) - max(begin, since)
                longest_s, total_s = max(longest_s, span_s), total_s + max(0.0, span_s)
        return total_s if most_s is None else longest_s + min(total_s - longest_s, most_s)

    def add(self, begin: float, end: float) -> None:
        """Record a span that another process reports about itself."""
        with self._lock:
            self._spans.append((max(begin, self._spans[-1][1] if self._spans else begin), end))

    def _notice(self, now: float) -> None:
        """Record a delay. Call with the lock held."""
        if self._due is not None and now - self._due >= NOISE_S:
            self._spans.append((self._due, now))
            self._due = now  # later delays are another span


class ProcessStallMeter:
    """Whether the first thread of another process could run, according to the kernel's counters in /proc/PID."""

    def __init__(self, pid: int, proc: str = "/proc") -> None:
        self._folder = f"{proc}/{pid}"
        self._last: tuple[float, float, float] | None = None

    def measure(self, now: float) -> float:
        """Seconds since the last call in which it was kept from running: it waited for a core, or still does, or for a
        disk. Sleeping or computing does not count. 0 in the first call, and if the kernel does not count."""
        before, self._last = self._last, self._read(now)
        if before is None or self._last is None:
            return 0.0
        passed_s, ran_s, waited_s = (new - old for new, old in zip(self._last, before, strict=True))
        # The kernel counts a wait when it ends: a process that is ready or waits for the disk, and has not run since,
        # is waiting now.
        held_s = passed_s - ran_s if self._state() in HELD else 0.0
        return min(passed_s, max(0.0, waited_s, held_s))

    def _read(self, now: float) -> tuple[float, float, float] | None:
        try:
            with open(f"{self._folder}/schedstat", "rb", buffering=0) as stream:
                ran_ns, waited_ns = stream.read(128).split()[:2]
                return now, int(ran_ns) / 1e9, int(waited_ns) / 1e9
        except (OSError, ValueError):
            return None

    def _state(self) -> str:
        try:
            with open(f"{self._folder}/stat", "rb", buffering=0) as stream:
                line = stream.read(512)
                return chr(line[line.rindex(b")") + 2])
        except (OSError, ValueError, IndexError):
            return ""


class DelayMonitor:
    """The measuring thread. What it measures is in `lateness`."""

    def __init__(self, lateness: SchedulingDelay, mono: Callable[[], float] = time.monotonic) -> None:
        self._lateness, self._mono = lateness, mono
        self._stopping = threading.Event()
        self.thread = threading.Thread(target=self._loop, name="phm-scheduling", daemon=True)

    def stop(self) -> None:
        self._stopping.set()

    def _loop(self) -> None:
        while not self._stopping.is_set():
            self._lateness.expect(self._mono() + PERIOD_S)
            self._stopping.wait(PERIOD_S)
            self._lateness.record_run(self._mono())
