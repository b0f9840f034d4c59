"""From when on a topic counts as silent: as early as its pauses so far allow."""

from __future__ import annotations

from collections import deque

FLOOR_S = 1.0
"""Nothing is silent before: a process that waits for its processor is not."""
MARGIN_S = 0.5
"""Two looks: a sample that came just after one is seen at the next."""
PERIODS = 1.5
"""Nor is anything before so many of its expected periods, nor before one and MARGIN_S: a publisher that ends just before
it would have published is called silent half a second later at the earliest, which `settle_s` of the check relies on."""
SPREADS = 2.0
"""The longest pause seen may be passed by so many times what it was longer than usual."""
LEAST, LEAST_S = 20, 15.0
"""As many pauses, over as long, must have been seen before the limit comes down from the configured one."""
HORIZON_S = 600.0
"""For how long a pause is remembered, or HORIZON periods where that is longer."""
HORIZON = 60
_SHARE = 0.05
BUCKETS = 10


class WindowedMax:
    """The largest number of the last `least_s` seconds, or up to a tenth longer. Times must not go back."""

    def __init__(self, least_s: float) -> None:
        self._bucket_s = least_s / BUCKETS
        self._buckets: deque[tuple[float, float]] = deque(maxlen=BUCKETS + 1)

    def add(self, number: float, now_s: float) -> None:
        buckets = self._buckets
        if buckets and now_s - buckets[-1][0] < self._bucket_s:
            began_s, most = buckets[-1]
            if number > most:
                buckets[-1] = (began_s, number)
            return
        buckets.append((now_s, number))
        while now_s - buckets[0][0] >= self._bucket_s * (BUCKETS + 1):
            buckets.popleft()

    def clear(self) -> None:
        self._buckets.clear()

    @property
    def most(self) -> float | None:
        """None when nothing was added, or nothing since `clear`."""
        return max(number for _, number in self._buckets) if self._buckets else None


class SilenceTimeout:
    """The silence limit of one topic.

    `most_s` is the configured limit, and never exceeded. Below it the limit follows the pauses that ended by
    themselves: longest + max(0.5 s, 2 * (longest - usual)), at least 1 s and 1.5 expected periods (or, below a period of
    a second, one and half a second). So a topic that
    never paused for much longer than its period is called silent soon, and one that pauses at will is given its time.
    A pause is what the looks saw of it: the time without a new sample at the last look before one came.
    """

    def __init__(self, expected_hz: float, most_s: float) -> None:
        self.most_s = most_s
        period_s = 1.0 / expected_hz
        self._least_s = max(FLOOR_S, PERIODS * period_s, period_s + MARGIN_S)
        self._longest = WindowedMax(max(HORIZON_S, HORIZON * period_s))
        self._usual_s = 0.0
        self._seen = 0
        self._began_s: float | None = None
        self._limit_s = most_s

    @property
    def limit_s(self) -> float:
        return self._limit_s

    def ended(self, pause_s: float, now_s: float) -> None:
        """A pause, perhaps of no length, ended by itself. One above `most_s` was a silence and teaches nothing."""
        if pause_s > self.most_s:
            return
        if self._began_s is None:
            self._began_s = now_s
        self._seen += 1
        self._usual_s += max(_SHARE, 1 / self._seen) * (pause_s - self._usual_s)
        self._longest.add(pause_s, now_s)
        if self._seen >= LEAST and now_s - self._began_s >= LEAST_S:
            longest_s = self._longest.most or 0.0
            margin_s = max(MARGIN_S, SPREADS * (longest_s - self._usual_s))
            self._limit_s = min(self.most_s, max(self._least_s, longest_s + margin_s))
