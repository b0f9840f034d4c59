"""Measurements over time with a bounded number of points: when they are too many, two become one."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

POINTS = 512


@dataclass
class Series:
    """Means of `stride` measurements each. at: seconds on the monotonic clock of the run, ascending within a part."""

    at: array[float] = field(default_factory=lambda: array("d"))
    value: array[float] = field(default_factory=lambda: array("d"))
    stride: int = 1
    most: int = POINTS
    _waiting: list[tuple[float, float]] = field(default_factory=list)

    def add(self, at: float, value: float) -> None:
        self._waiting.append((at, value))
        if len(self._waiting) >= self.stride:
            self._flush()
        if len(self.at) > self.most:
            self._halve()

    def limit(self, most: int) -> None:
        """Have at most so many points from now on; a limit that was smaller stays."""
        self.most = min(self.most, most)
        while len(self.at) > self.most:
            self._halve()

    def merge(self, other: Series) -> None:
        """Take the points of the same measurement in another part."""
        self._flush()
        other._flush()
        pairs = sorted([*zip(self.at, self.value, strict=True), *zip(other.at, other.value, strict=True)])
        self.at, self.value = array("d", (at for at, _ in pairs)), array("d", (value for _, value in pairs))
        self.stride = max(self.stride, other.stride)
        self.limit(other.most)

    def points(self) -> list[tuple[float, float]]:
        self._flush()
        return list(zip(self.at, self.value, strict=True))

    def _flush(self) -> None:
        if self._waiting:
            self.at.append(self._waiting[-1][0])
            self.value.append(sum(value for _, value in self._waiting) / len(self._waiting))
            self._waiting.clear()

    def _halve(self) -> None:
        even = len(self.at) & ~1
        tail_at, tail = self.at[even:], self.value[even:]
        halves = zip(self.value[0:even:2], self.value[1:even:2], strict=True)
        self.value = array("d", ((one + two) / 2 for one, two in halves)) + tail
        self.at = self.at[1:even:2] + tail_at
        self.stride *= 2
