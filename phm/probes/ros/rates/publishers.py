"""Several publishers of one topic: assigns samples to publishers, and counts restarts."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from phm.probes.ros.rates.publisher_stats import PublisherStats, Sample

MOST = 8
"""Maximum number of publishers that are distinguished; with more, a queue of acceptable length has too few samples of
each."""
PER_PUBLISHER, DEPTH_MOST = 16, 64
"""Samples in the queue for each of them: three make a line, and while the queue is not full they can be counted."""
_STEADY = 3
"""This many sequence numbers determine a slope."""
_ROOM, _ROOM_FULL = 3.0, 64.0
"""How many numbers a sample may be off its line, or as many as are expected if more. The same applies while there are
as many active lines as publishers, because then the sample must belong to one of them."""
_AT_WORK_NS = 2e9
_BASE_S = 2.0
"""Publication time over which a slope is measured."""
_AGAIN_S = 20.0
_BIRTHS_S = 10.0
"""Within this time one new line is a restarted publisher; more mean that samples were assigned wrongly."""
GONE_S = 1.0
"""A publisher is gone when another was received this much later, or GONE_PERIODS of its own periods if that is longer."""
GONE_PERIODS = 6
NEW_S = 5.0
"""A publisher whose first sequence number covers at most this many seconds has just begun: discovery finds it by then.
"""
_STRAY = 0.5
"""A sequence number may differ from its expected value by one, and by this share of the expected numbers."""
_ENDS, _NAMES = 4, 16


@dataclass(slots=True)
class _Line:
    """The sequence numbers of one publisher. `base`: the (number, ns) from which the slope is measured, then the next
    one."""

    name: bytes
    number: int
    at_ns: int
    base: tuple[int, int]
    next_base: tuple[int, int]
    period_ns: float | None = None

    def deviation(self, number: int, at_ns: int) -> float | None:
        """How far the sample is off the line, in numbers; None if it cannot be a later sample of it."""
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
    """Assigns each sample to its line, as its writer, and counts all of them together."""

    def __init__(self, counted_over_s: float) -> None:
        self._lines: list[_Line] = []
        self._made = 0
        self._births: deque[float] = deque(maxlen=4 * MOST)
        self._all = PublisherStats(counted_over_s)
        self._began_s: float | None = None

    def sort(self, samples: Sequence[Sample], publishers: int, *, complete: bool) -> list[Sample]:
        """publishers: their number according to discovery. complete: nothing was published that is not among `samples`."""
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
        """Continue with a publisher that was alone until now: its newest sample and rate. Returns the name of its line."""
        line = self._new(last)
        self._births.clear()
        line.period_ns = 1e9 / hz if hz else None
        return line.name

    @property
    def counted_hz(self) -> float | None:
        """Rate of all publishers together, by counting; None while some samples of the window were missed."""
        return self._all.hz

    def unreliable(self, publishers: int, now_s: float) -> bool:
        """Whether the lines are unreliable. publishers: their number according to discovery."""
        born = sum(now_s - born_s <= _BIRTHS_S for born_s in self._births)
        young = self._began_s is None or now_s - self._began_s <= _BIRTHS_S
        at_work = self._at_work(max((line.at_ns for line in self._lines), default=0))
        return publishers > MOST or at_work > publishers or born > 1 + (publishers if young else 0)

    def _try_again(self, publishers: int, now_s: float) -> None:
        """Wrongly assigned samples stay so: restart after a while."""
        if self._began_s is not None and now_s - self._began_s > _AGAIN_S and self.unreliable(publishers, now_s):
            self._began_s = None
            self._lines.clear()
            self._births.clear()

    def _line(self, sample: Sample, publishers: int) -> _Line:
        assert sample.sequence is not None
        number, at_ns = sample.sequence, sample.source_ns
        offs = [
            # A sample that follows by one is the next, however late or early. Of equals, the line that waited longest.
            (0.0 if number == line.number + 1 else off, line.at_ns, line)
            for line in self._lines
            if (off := line.deviation(number, at_ns)) is not None
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
    """How long a publisher of this rate may be silent while another one is not."""
    return max(GONE_S, GONE_PERIODS / hz if hz else 0.0)


@dataclass(frozen=True, slots=True)
class _End:
    """The newest sample of a sequence that another one seems to have replaced."""

    last: Sample
    hz: float


class PublisherRestarts:
    """`count` may fall again: a publisher that seemed gone returned. expected_hz: of the topic."""

    def __init__(self, expected_hz: float) -> None:
        self._expected_hz = expected_hz
        self._ends: deque[_End] = deque(maxlen=_ENDS)
        self._replaced: OrderedDict[bytes | None, None] = OrderedDict()
        self.count = 0

    def numbers_fell(self, last: Sample, hz: float | None) -> None:
        """A lower number followed `last`, of a publisher of this rate: a restart, or another publisher."""
        self._ends.append(_End(last, min(hz or self._expected_hz, self._expected_hz)))

    def receive(self, sample: Sample, last: Sample | None) -> None:
        """A sample, and the previous one of its apparent publisher: does a sequence that ended continue?"""
        for end in list(self._ends):
            off = _off(end.last, sample, end.hz)
            if off < math.inf and off <= _off(last, sample, end.hz):
                self._ends.remove(end)

    def settle(self, now_s: float, closed_s: float, *, mixed: bool) -> None:
        """Called once per poll. closed_s: how long there is no subscription. mixed: the numbers are those of several
        publishers."""
        if mixed:
            self._ends.clear()
        for end in list(self._ends):
            if now_s - end.last.at_s > gone_after_s(end.hz) + closed_s:
                self._ends.remove(end)
                self.count += 1

    def gone(self, writer: bytes | None, track: PublisherStats, others: list[PublisherStats]) -> None:
        """A distinguishable publisher fell silent: did one of them replace it?"""
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
        """An unknown publisher sends: one that seemed gone has not been replaced after all."""
        if writer in self._replaced:
            del self._replaced[writer]
            self.count -= 1


def _off(last: Sample | None, sample: Sample, hz: float) -> float:
    """How many numbers `sample` is off the successor of `last` at this rate; infinite if it cannot be of the same
    publisher."""
    if last is None or last.sequence is None or sample.sequence is None or sample.sequence <= last.sequence:
        return math.inf
    expected = max(1.0, hz * (sample.source_ns - last.source_ns) / 1e9)
    off = abs(sample.sequence - last.sequence - expected)
    return off if off <= 1 + _STRAY * expected else math.inf
