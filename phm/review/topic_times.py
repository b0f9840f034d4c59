"""When the messages of one topic were recorded: first, last, the usual period, and gaps. In bounded memory."""

from __future__ import annotations

import heapq
import statistics
from array import array
from dataclasses import dataclass, field

GAP_PERIODS = 5.0
"""A gap is longer than this many median periods of its own topic."""
LEAST_GAP_S = 0.5
MOST_GAPS = 50
"""Maximum number of gaps of one topic; the longest are kept."""
LEAST_PERIODS = 20
REGULAR = 2.0
"""A topic has gaps only if it is regular: 9 of 10 periods are at most this many medians. Others are sent when there is something."""
SAMPLES = 2048


@dataclass
class TopicTimes:
    """Times in seconds, in any order; one that is earlier than the one before makes no period."""

    count: int = 0
    first: float = 0.0
    last: float = 0.0
    early: int = 0
    """Number of messages that are older than one before them."""
    _periods: array[float] = field(default_factory=lambda: array("d"))
    _stride: int = 1
    _longest: list[tuple[float, float]] = field(default_factory=list)
    """A heap of entries (period, its begin)."""

    def add(self, t: float) -> None:
        self.count += 1
        if self.count == 1:
            self.first = self.last = t
            return
        period = t - self.last
        if period < 0:
            self.early += 1
            self.first = min(self.first, t)
            return
        if self.count % self._stride == 0:
            self._periods.append(period)
            if len(self._periods) > SAMPLES:
                self._periods = self._periods[::2]
                self._stride *= 2
        if len(self._longest) < MOST_GAPS:
            heapq.heappush(self._longest, (period, self.last))
        elif period > self._longest[0][0]:
            heapq.heapreplace(self._longest, (period, self.last))
        self.last = t

    def period(self) -> float | None:
        """The median of the periods, in seconds; None: too few messages."""
        return statistics.median(self._periods) if len(self._periods) >= LEAST_PERIODS else None

    def limit(self) -> float | None:
        """What is longer than this is a gap, in seconds; None: the topic is not regular, so none is."""
        median = self.period()
        if median is None:
            return None
        nine_of_ten = sorted(self._periods)[len(self._periods) * 9 // 10]
        return max(GAP_PERIODS * median, LEAST_GAP_S) if nine_of_ten <= REGULAR * median else None

    def gaps(self) -> list[tuple[float, float]]:
        """(begin, seconds) of at most MOST_GAPS, the longest, in the order of time."""
        limit = self.limit()
        return [] if limit is None else sorted((begin, long) for long, begin in self._longest if long > limit)
