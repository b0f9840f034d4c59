"""What PHM cost over time: totals since its start, in a bounded number of samples."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field

MOST = 2048
"""Samples of one run: 11 hours of a report every 20 s; of a longer run every second, fourth ... one is kept."""


@dataclass
class Cost:
    """samples: (mono, CPU seconds and bytes sent since PHM's start, bytes of memory then), in any order."""

    samples: list[tuple[float, float, int, int]] = field(default_factory=list)

    def add(self, mono: float, cpu_s: float, sent_bytes: int, memory_bytes: int) -> None:
        self.samples.append((mono, cpu_s, sent_bytes, memory_bytes))
        self._limit()

    def merge(self, other: Cost) -> None:
        self.samples = sorted({*self.samples, *other.samples})
        self._limit()

    def between(self, begin: float, end: float) -> tuple[float, float, float] | None:
        """(seconds, CPU seconds, bytes sent) between two monotonic times, or between the first and the last sample where these
        are nearer; interpolated between two samples. None: that needs two of them."""
        ordered = sorted(self.samples)
        if len(ordered) < 2:
            return None
        begin, end = max(begin, ordered[0][0]), min(end, ordered[-1][0])
        if end <= begin:
            return None
        first, last = _at(ordered, begin), _at(ordered, end)
        return end - begin, max(0.0, last[0] - first[0]), max(0.0, last[1] - first[1])

    def memory(self, begin: float, end: float) -> int:
        """The most between two monotonic times; 0: not known."""
        return max((memory for mono, _, _, memory in self.samples if begin <= mono <= end), default=0)

    def _limit(self) -> None:
        if len(self.samples) <= MOST:
            return
        ordered = sorted(self.samples)
        inner = ordered[1:-1]
        # Totals lose nothing when every second one goes; of the memory the larger of both is kept.
        pairs = [inner[place : place + 2] for place in range(0, len(inner), 2)]
        kept = [(*pair[-1][:3], max(sample[3] for sample in pair)) for pair in pairs]
        self.samples = [ordered[0], *kept, ordered[-1]]


def _at(ordered: Sequence[tuple[float, float, int, int]], mono: float) -> tuple[float, float]:
    """CPU seconds and bytes at this time, which is within the samples."""
    place = min(max(1, bisect_left(ordered, (mono,))), len(ordered) - 1)
    one, two = ordered[place - 1], ordered[place]
    share = (mono - one[0]) / (two[0] - one[0]) if two[0] > one[0] else 1.0
    share = min(max(share, 0.0), 1.0)
    return one[1] + share * (two[1] - one[1]), one[2] + share * (two[2] - one[2])
