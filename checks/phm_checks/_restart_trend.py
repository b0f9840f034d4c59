"""Whether the restarts of a container become more frequent: the Laplace test of a series of events (IEC 60706-6)."""

from __future__ import annotations

import math
from collections import deque
from statistics import NormalDist

from phm import api

LEAST = 4
"""Fewer restarts show no trend with confidence."""
MOST = 50


class RestartTrend:
    """The starts of one container within the newest `window_s` seconds."""

    def __init__(self, window_s: float, confidence_percent: float) -> None:
        """window_s: observed time; 0: the trend is never rising."""
        self.window_s = window_s
        self._bound = NormalDist().inv_cdf(confidence_percent / 100)
        self._since_s: float | None = None
        self._generation = ""
        self._restarts: deque[float] = deque(maxlen=MOST)

    def observe(self, fact: api.ContainerFact, now_s: float) -> None:
        """Take the container's state at `now_s` (monotonic seconds)."""
        if self._since_s is None:
            self._since_s = now_s
        elif fact.generation != self._generation:
            self._restarts.append(now_s)
        self._generation = fact.generation
        while self._restarts and now_s - self._restarts[0] > self.window_s:
            self._restarts.popleft()

    @property
    def count(self) -> int:
        return len(self._restarts)

    def rising(self, now_s: float) -> bool:
        """Whether the restarts come later in the observed time than chance allows."""
        if self._since_s is None or self.count < LEAST:
            return False
        start_s = max(self._since_s, now_s - self.window_s)
        if (span_s := now_s - start_s) <= 0:
            return False
        mean_s = sum(at_s - start_s for at_s in self._restarts) / self.count
        return (mean_s - span_s / 2) * math.sqrt(12 * self.count) / span_s > self._bound
