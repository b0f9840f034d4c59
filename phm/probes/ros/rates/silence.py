"""The time from which a topic counts as silent: as short as its pauses so far permit."""

from __future__ import annotations

import math
from collections import deque

FLOOR_S = 1.0
"""Minimum limit: a process that waits for a CPU is not silent."""
MARGIN_S = 0.5
"""Two polls: a sample that arrived just after one is seen at the next."""
PERIODS = 1.5
"""Minimum limit in expected periods, and one period plus MARGIN_S: a publisher that ends just before its next
publication is reported as silent at least half a second later, on which `settle_s` of the check relies."""
SETTLE_S = 2.0
"""The check `rates` reports a silence this much after the limit (its `SETTLE_S`)."""
SPREADS = 2.0
"""The longest pause may be exceeded by this many times its difference from the usual one."""
LEAST, LEAST_S = 20, 15.0
"""This many pauses, over this time, must have been observed before the limit falls below the configured one."""
HORIZON_S = 600.0
"""How long a pause is remembered, or HORIZON periods if longer."""
HORIZON = 60
LOST, LOST_MOST_S = 2.0, 30.0
"""A pause in which messages were only lost on the way may be exceeded by this factor, up to LOST_MOST_S, or to the configured
limit by this factor if that is longer: the end of the publisher must still be found."""
LOST_S = 120.0
"""How long such a pause is remembered, or HORIZON periods if longer: it may have been an interruption of the network."""
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
        """The maximum; None if nothing was added since the start or `clear`."""
        return max(number for _, number in self._buckets) if self._buckets else None


class SilenceTimeout:
    """The silence limit of one topic. `most_s` is the configured limit, and exceeded only by `disproved`; the limit never falls below
    `least_s`.

    Between them the limit follows the pauses that ended by themselves: longest + max(0.5 s, 2 * (longest - usual)), at
    least 1 s and 1.5 expected periods (or, below a period of a second, one period and half a second). So a topic that
    never paused for much longer than its period is reported soon, and an irregular one gets more time. A pause is
    measured by the polls: the time without a new sample at the last poll before one arrived.

    One missing message is not a fault: the limit and SETTLE_S together are half a second longer than two periods, and
    than the longest pause and a period. This matters only for periods above two seconds.
    """

    def __init__(self, expected_hz: float, most_s: float, least_s: float = 0.0) -> None:
        self.most_s = most_s
        period_s = 1.0 / expected_hz
        self._missing_s = period_s + MARGIN_S - SETTLE_S
        """How much longer than a pause the limit must be, so that a missing message is not reported."""
        self._least_s = max(least_s, FLOOR_S, PERIODS * period_s, period_s + max(MARGIN_S, self._missing_s))
        self._longest = WindowedMax(max(HORIZON_S, HORIZON * period_s))
        self._usual_s = 0.0
        self._seen = 0
        self._began_s: float | None = None
        self._limit_s = most_s
        self._remembered_s = max(LOST_S, HORIZON * period_s)
        self._lost = WindowedMax(self._remembered_s)
        """Limits by pauses in which messages were only lost on the way."""
        self._disproved_s = -math.inf

    @property
    def limit_s(self) -> float:
        return max(self._limit_s, self._lost.most or 0.0)

    def ended(self, pause_s: float, now_s: float) -> None:
        """Record a pause, perhaps of zero length, that ended by itself. One above `most_s` was a silence and is not
        used."""
        if self._lost.most:
            self._lost.add(0.0, now_s)
        if pause_s > self.most_s:
            return
        if self._began_s is None:
            self._began_s = now_s
        self._seen += 1
        self._usual_s += max(_SHARE, 1 / self._seen) * (pause_s - self._usual_s)
        self._longest.add(pause_s, now_s)
        if self._seen >= LEAST and now_s - self._began_s >= LEAST_S:
            longest_s = self._longest.most or 0.0
            margin_s = max(MARGIN_S, SPREADS * (longest_s - self._usual_s), self._missing_s)
            self._limit_s = min(self.most_s, max(self._least_s, longest_s + margin_s))

    def disproved(self, pause_s: float, now_s: float) -> None:
        """Record a silence that was none: its messages were published, and lost on the way to PHM. The next ones may be, too, if these
        were not the first within the time that is remembered: those may have been an interruption of the network."""
        before_s, self._disproved_s = self._disproved_s, now_s
        if now_s - before_s <= self._remembered_s:
            self._lost.add(min(LOST * pause_s, max(LOST_MOST_S, LOST * self.most_s)), now_s)
