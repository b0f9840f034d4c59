"""Detects that the computer's tasks wait for memory or for its disks, from the kernel's pressure stall information.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections import deque

from phm import api
from phm.api import Level
from phm_checks._window_threshold import WindowThreshold

NEWEST_S = 2.0
_MOST_READINGS = 2000


class HostPressure:
    """One resource: the mean share of time in which all of the computer's tasks waited for it, over a full window."""

    def __init__(self, limit: api.Limit, window_s: float) -> None:
        self._threshold, self._warn = WindowThreshold(limit.warn, limit.error), limit.warn
        self.rising = False
        """Whether the newest readings are above the limit, whatever the entire window says."""
        self._window_s = window_s
        self._readings: deque[tuple[float, float]] = deque(maxlen=_MOST_READINGS)

    def judge(self, percent: float | None, now: float) -> tuple[Level, float]:
        """The level and the mean; OK while the window is not full, or if the kernel does not provide the counters."""
        if percent is None:
            self._readings.clear()
            self.rising = False
            return self._threshold.level(None, None), 0.0
        self._readings.append((now, percent))
        while len(self._readings) > 1 and self._readings[1][0] <= now - self._window_s:
            self._readings.popleft()
        mean, newest = self._mean(now - self._window_s), self._mean(now - NEWEST_S)
        self.rising = newest >= self._warn
        full = now - self._readings[0][0] >= self._window_s
        return self._threshold.level(mean if full else None, newest), mean

    def _mean(self, since: float) -> float:
        inside = [percent for at, percent in self._readings if at > since]
        return sum(inside) / len(inside)
