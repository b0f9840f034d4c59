"""Several publishers of one topic: whose samples are whose, and how often a publisher was restarted."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from phm.probes.ros.rates.publisher_stats import PublisherStats, Sample

MOST = 8
"""Most publishers that are distinguished; with more, a queue of acceptable length holds too few samples of each."""
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
"""In so long one new line is a publisher that was restarted; more mean that samples were mistaken for others'."""
GONE_S = 1.0
"""A publisher is gone when another was heard this much later, or GONE_PERIODS of its own where that is longer."""
GONE_PERIODS = 6
NEW_S = 5.0
"""A publisher whose first sample has a number of no more seconds than this has just begun: it is discovered by then."""
_STRAY = 0.5
"""A number may be off where its publisher is expected to be by one, and by this share of those that are expected."""
_ENDS, _NAMES = 4, 16


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
        """Mistaken samples stay so: restart after a while."""
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


def gone_after_s(hz: float) -> float:
    """How long a publisher of this rate may be silent beside one that is not."""
    return max(GONE_S, GONE_PERIODS / hz if hz else 0.0)


@dataclass(frozen=True, slots=True)
class _End:
    """The newest sample of a sequence that another one seems to have taken the place of."""

    last: Sample
    hz: float


class PublisherRestarts:
    """`count` may fall again: a publisher that was taken for gone came back. expected_hz: of the topic."""

    def __init__(self, expected_hz: float) -> None:
        self._expected_hz = expected_hz
        self._ends: deque[_End] = deque(maxlen=_ENDS)
        self._replaced: OrderedDict[bytes | None, None] = OrderedDict()
        self.count = 0

    def fell(self, last: Sample, hz: float | None) -> None:
        """A smaller number came after `last`, of a publisher of this rate: another life of it, or another one."""
        self._ends.append(_End(last, min(hz or self._expected_hz, self._expected_hz)))

    def hear(self, sample: Sample, last: Sample | None) -> None:
        """A sample, and the one before it of what is taken for its publisher: does a sequence that ended go on?"""
        for end in list(self._ends):
            off = _off(end.last, sample, end.hz)
            if off < math.inf and off <= _off(last, sample, end.hz):
                self._ends.remove(end)

    def settle(self, now_s: float, closed_s: float, *, mixed: bool) -> None:
        """Called once a look. closed_s: how long there is no subscription. mixed: the numbers are those of several publishers."""
        if mixed:
            self._ends.clear()
        for end in list(self._ends):
            if now_s - end.last.at_s > gone_after_s(end.hz) + closed_s:
                self._ends.remove(end)
                self.count += 1

    def gone(self, writer: bytes | None, track: PublisherStats, others: list[PublisherStats]) -> None:
        """A distinguishable publisher fell silent: did one of them take its place?"""
        most = 1 + NEW_S * max(track.hz or 0.0, self._expected_hz)
        heir = next((other for other in others if other.takes_place(track, most)), None)
        if heir is None:
            return
        heir.replaced = True
        self.count += 1
        self._replaced[writer] = None
        while len(self._replaced) > _NAMES:
            self._replaced.popitem(last=False)

    def back(self, writer: bytes | None) -> None:
        """A publisher that is not known is heard: one that was gone has not been replaced after all."""
        if writer in self._replaced:
            del self._replaced[writer]
            self.count -= 1


def _off(last: Sample | None, sample: Sample, hz: float) -> float:
    """How many numbers `sample` is off what follows `last` at this rate; infinite when it cannot be of the same publisher."""
    if last is None or last.sequence is None or sample.sequence is None or sample.sequence <= last.sequence:
        return math.inf
    expected = max(1.0, hz * (sample.source_ns - last.source_ns) / 1e9)
    off = abs(sample.sequence - last.sequence - expected)
    return off if off <= 1 + _STRAY * expected else math.inf
