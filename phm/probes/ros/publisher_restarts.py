"""How often the publishers of one topic began anew: one sequence of numbers ended for good, and another began after it.

A killed publisher stays listed until its lease ends, so the list cannot tell a restart from a second publisher. The numbers
can: of two that live, both go on. So what looks like a restart counts only once the older sequence has been silent for
as long as a publisher that is gone.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from dataclasses import dataclass

from phm.probes.ros.publisher_stats import PublisherStats, Sample

GONE_S = 1.0
"""A publisher is gone when another was heard this much later, or GONE_PERIODS of its own where that is longer."""
GONE_PERIODS = 6
NEW_S = 5.0
"""A publisher whose first sample has a number of no more seconds than this has just begun: it is discovered by then."""
_STRAY = 0.5
"""A number may be off where its publisher is expected to be by one, and by this share of those that are expected."""
_ENDS, _NAMES = 4, 16


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
        """Called once a look. closed_s: how long nobody listens. mixed: the numbers are those of several publishers."""
        if mixed:
            self._ends.clear()
        for end in list(self._ends):
            if now_s - end.last.at_s > gone_after_s(end.hz) + closed_s:
                self._ends.remove(end)
                self.count += 1

    def gone(self, writer: bytes | None, track: PublisherStats, others: list[PublisherStats]) -> None:
        """A publisher that can be told from the others fell silent: did one of them take its place?"""
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
