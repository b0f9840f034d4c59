"""Intervals of numbers: what a record covers in time, and which sequence numbers it has."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Span = list[float]


class Cover:
    """Intervals that are joined when they are at most `tolerance` apart. Cheap for values that ascend."""

    def __init__(self, tolerance: float) -> None:
        self.tolerance = tolerance
        self.spans: list[Span] = []

    def add(self, value: float) -> None:
        if self.spans:
            last = self.spans[-1]
            if last[0] <= value <= last[1] + self.tolerance:
                last[1] = max(last[1], value)
                return
        self.spans.append([value, value])
        if len(self.spans) > 20_000:
            self.spans = joined(self.spans, self.tolerance)

    def merge(self, other: Cover) -> None:
        self.spans = joined([*self.spans, *other.spans], self.tolerance)

    def gaps(self) -> list[Span]:
        """The gaps between the intervals, ascending."""
        self.spans = joined(self.spans, self.tolerance)
        return [[before[1], after[0]] for before, after in zip(self.spans, self.spans[1:], strict=False)]


def joined(spans: Iterable[Sequence[float]], tolerance: float = 0.0) -> list[Span]:
    """Sorted, and one where they overlap or are at most `tolerance` apart."""
    result: list[Span] = []
    for begin, end in sorted((span[0], span[1]) for span in spans):
        if result and begin <= result[-1][1] + tolerance:
            result[-1][1] = max(result[-1][1], end)
        else:
            result.append([begin, end])
    return result


def clipped(spans: Iterable[Sequence[float]], begin: float, end: float) -> list[Span]:
    """The parts of the spans between begin and end."""
    cut = ([max(span[0], begin), min(span[1], end)] for span in spans)
    return [span for span in cut if span[0] < span[1]]


def total(spans: Iterable[Sequence[float]]) -> float:
    return sum(span[1] - span[0] for span in spans)


def without(spans: Iterable[Sequence[float]], holes: Iterable[Sequence[float]]) -> list[Span]:
    """The spans minus the holes."""
    rest = joined(spans)
    for begin, end in joined(holes):
        cut: list[Span] = []
        for span in rest:
            cut += clipped([span], float("-inf"), begin) + clipped([span], end, float("inf"))
        rest = cut
    return rest


def both(one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]) -> list[Span]:
    """What is in both of two lists of joined spans."""
    found: list[Span] = []
    mine = theirs = 0
    while mine < len(one) and theirs < len(other):
        begin, end = max(one[mine][0], other[theirs][0]), min(one[mine][1], other[theirs][1])
        if begin < end:
            found.append([begin, end])
        if one[mine][1] < other[theirs][1]:
            mine += 1
        else:
            theirs += 1
    return found
