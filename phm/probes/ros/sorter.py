"""Tells the samples of several publishers of one topic apart where the middleware does not say who sent them.

Each publisher numbers its samples by itself, so over time its numbers form a line of their own: a start and a slope,
which is its rate. A sample belongs to the line that it lies on. Publishers of equal rate whose lines lie together may
be taken for one another, which changes no rate. Lines whose publishers are very uneven get mixed up, which shows by
ever new lines; as long as the queue is not full between two looks, their samples can still be counted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace

from phm.probes.ros.track import Sample, Track

MOST = 8
"""Publishers that are told apart; of more, a queue of bearable length shows too few samples each."""
PER_PUBLISHER, DEPTH_MOST = 16, 64
"""Samples in the queue for each of them: three make a line, and while it is not full they can be counted."""
_STEADY = 3
"""So many numbers make a slope."""
_NEW_COST = 1.0
"""What keeps a line without a slope from taking a sample that lies on another one's."""
_OFF_MOST, _OFF_SHARE = 0.25, 0.02
"""When samples lie off their lines by more than this many numbers on average, lines are taken for one another."""
_BASE_S = 2.0
"""A slope is measured over this much publication time."""
_BIRTHS_S = 10.0
"""In so long one new line is a publisher that was restarted; more tell that samples were taken for others'."""


@dataclass(slots=True)
class _Line:
    """The numbers of one publisher. `base`: the (number, ns) that the slope is measured from, then the next one."""

    name: bytes
    number: int
    at_ns: int
    base: tuple[int, int]
    next_base: tuple[int, int]
    period_ns: float | None = None

    def cost(self, number: int, at_ns: int) -> float | None:
        """How far off the line this is, in numbers; None when it cannot be its next sample."""
        count, passed_ns = number - self.number, at_ns - self.at_ns
        if count <= 0 or passed_ns <= 0:
            return None
        if self.period_ns is None:
            return count - 1 + _NEW_COST if count <= _STEADY else None
        expected = passed_ns / self.period_ns
        off = abs(count - expected)
        return off if off <= max(1.0, expected / 4) else None

    def take(self, number: int, at_ns: int) -> None:
        self.number, self.at_ns = number, at_ns
        if at_ns - self.next_base[1] > _BASE_S * 1e9:
            self.base, self.next_base = self.next_base, (number, at_ns)
        count = number - self.base[0]
        if count >= _STEADY:
            self.period_ns = (at_ns - self.base[1]) / count


class Sorter:
    """Gives each sample the name of its line as writer, and counts them all together."""

    def __init__(self, counted_over_s: float) -> None:
        self._lines: list[_Line] = []
        self._made = 0
        self._births: deque[float] = deque(maxlen=4 * MOST)
        self._all = Track(counted_over_s)
        self._began_s: float | None = None
        self._off = 0.0

    def sort(self, samples: Iterable[Sample], *, complete: bool) -> list[Sample]:
        """complete: these are all samples that were published since the last ones."""
        sorted_samples = []
        for sample in samples:
            self._began_s = sample.at_s if self._began_s is None else self._began_s
            self._all.add(replace(sample, sequence=None))
            sorted_samples.append(replace(sample, writer=self._line(sample).name))
        if not complete:
            self._all.forget()
        return sorted_samples

    @property
    def counted_hz(self) -> float | None:
        """All publishers together, by counting; None while some samples of the window were not seen."""
        return self._all.hz

    def puzzled(self, publishers: int, now_s: float) -> bool:
        """Whether the lines cannot be trusted. publishers: how many there are by discovery."""
        born = sum(now_s - born_s <= _BIRTHS_S for born_s in self._births)
        young = self._began_s is None or now_s - self._began_s <= _BIRTHS_S
        return publishers > MOST or self._off > _OFF_MOST or born > 1 + (publishers if young else 0)

    def _line(self, sample: Sample) -> _Line:
        assert sample.sequence is not None
        number, at_ns = sample.sequence, sample.source_ns
        costs = [(cost, line.at_ns, line) for line in self._lines if (cost := line.cost(number, at_ns)) is not None]
        # Of equals, the one that has waited longest.
        off, _, line = min(costs, key=lambda entry: entry[:2]) if costs else (0.0, 0, self._new(sample))
        if line.period_ns is not None:
            self._off += _OFF_SHARE * (off - self._off)
        line.take(number, at_ns)
        return line

    def _new(self, sample: Sample) -> _Line:
        assert sample.sequence is not None
        self._made += 1
        self._births.append(sample.at_s)
        start = (sample.sequence, sample.source_ns)
        line = _Line(b"#%d" % self._made, *start, base=start, next_base=start)
        self._lines.append(line)
        if len(self._lines) > 2 * MOST:
            self._lines.remove(min(self._lines, key=lambda line: line.at_ns))
        return line
