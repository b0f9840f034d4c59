"""Tells the samples of several publishers of one topic apart where the middleware does not say who sent them.

Each publisher numbers its samples by itself, so over time its numbers form a line of their own. Between two looks a queue
keeps the last samples of all of them: within it numbers of one line follow each other by one, whenever they come; across
what the queue lost, they go on about as steeply as before. Two lines that are taken for one another keep their sum,
so that only a line too many or too few changes the rate; it shows by lines that are born.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from phm.probes.ros.publisher_stats import PublisherStats, Sample

MOST = 8
"""Publishers that are told apart; of more, a queue of bearable length shows too few samples each."""
PER_PUBLISHER, DEPTH_MOST = 16, 64
"""Samples in the queue for each of them: three make a line, and while it is not full they can be counted."""
_STEADY = 3
"""So many numbers make a slope."""
_ROOM, _ROOM_FULL = 3.0, 64.0
"""How many numbers a sample may be off its line, or as many as are expected where that is more; and the same while there
are as many lines at work as publishers, since then it must belong to one of them."""
_AT_WORK_NS = 2e9
_BASE_S = 2.0
"""A slope is measured over this much publication time."""
_AGAIN_S = 20.0
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

    def off(self, number: int, at_ns: int) -> float | None:
        """How far off the line this is, in numbers; None when it cannot be a later sample of it."""
        count, passed_ns = number - self.number, at_ns - self.at_ns
        if count <= 0 or passed_ns < 0:
            return None
        return abs(count - max(1.0, self.expected(at_ns)))

    def expected(self, at_ns: int) -> float:
        """How many numbers further it should be."""
        return (at_ns - self.at_ns) / self.period_ns if self.period_ns else 1.0

    def take(self, number: int, at_ns: int) -> None:
        self.number, self.at_ns = number, at_ns
        if at_ns - self.next_base[1] > _BASE_S * 1e9:
            self.base, self.next_base = self.next_base, (number, at_ns)
        count = number - self.base[0]
        if count >= _STEADY:
            self.period_ns = (at_ns - self.base[1]) / count


class PublisherDemux:
    """Gives each sample the name of its line as writer, and counts them all together."""

    def __init__(self, counted_over_s: float) -> None:
        self._lines: list[_Line] = []
        self._made = 0
        self._births: deque[float] = deque(maxlen=4 * MOST)
        self._all = PublisherStats(counted_over_s)
        self._began_s: float | None = None

    def sort(self, samples: Sequence[Sample], publishers: int, *, complete: bool) -> list[Sample]:
        """publishers: how many there are by discovery. complete: nothing was published that is not among `samples`."""
        sorted_samples = []
        self._try_again(publishers, samples[0].at_s)
        for sample in samples:
            self._began_s = sample.at_s if self._began_s is None else self._began_s
            self._all.add(replace(sample, sequence=None))
            sorted_samples.append(replace(sample, writer=self._line(sample, publishers).name))
        if not complete:
            self._all.forget()
        return sorted_samples

    def adopt(self, last: Sample, hz: float | None) -> bytes:
        """Go on with a publisher that was alone until now: its newest sample and rate. The name of its line."""
        line = self._new(last)
        self._births.clear()
        line.period_ns = 1e9 / hz if hz else None
        return line.name

    @property
    def counted_hz(self) -> float | None:
        """All publishers together, by counting; None while some samples of the window were not seen."""
        return self._all.hz

    def puzzled(self, publishers: int, now_s: float) -> bool:
        """Whether the lines cannot be trusted. publishers: how many there are by discovery."""
        born = sum(now_s - born_s <= _BIRTHS_S for born_s in self._births)
        young = self._began_s is None or now_s - self._began_s <= _BIRTHS_S
        at_work = self._at_work(max((line.at_ns for line in self._lines), default=0))
        return publishers > MOST or at_work > publishers or born > 1 + (publishers if young else 0)

    def _try_again(self, publishers: int, now_s: float) -> None:
        """What was taken for one another once stays so: begin anew after a while."""
        if self._began_s is not None and now_s - self._began_s > _AGAIN_S and self.puzzled(publishers, now_s):
            self._began_s = None
            self._lines.clear()
            self._births.clear()

    def _line(self, sample: Sample, publishers: int) -> _Line:
        assert sample.sequence is not None
        number, at_ns = sample.sequence, sample.source_ns
        offs = [
            # What follows by one is next, however late or early. Of equals, the one that has waited longest.
            (0.0 if number == line.number + 1 else off, line.at_ns, line)
            for line in self._lines
            if (off := line.off(number, at_ns)) is not None
        ]
        off, _, line = min(offs, key=lambda entry: entry[:2], default=(0.0, 0, None))
        if line is None or off > max(self._room(at_ns, publishers), line.expected(at_ns)):
            line = self._new(sample)
        line.take(number, at_ns)
        return line

    def _room(self, at_ns: int, publishers: int) -> float:
        return _ROOM if self._at_work(at_ns) < publishers else _ROOM_FULL

    def _at_work(self, at_ns: int) -> int:
        return sum(at_ns - line.at_ns < _AT_WORK_NS for line in self._lines)

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
