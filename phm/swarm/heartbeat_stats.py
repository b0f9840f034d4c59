"""Statistics of one peer's heartbeats: period, jitter and loss. Pure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

GAPS = 15
"""The period is the median of this many gaps: losses of up to a third of the frames hardly move it."""
MEMORY = 150.0
"""Heartbeats over which the share that is lost is counted, the older ones less."""
PRIOR_LOST, PRIOR_RECEIVED = 2.0, 8.0
"""Before anything is known, a fifth is assumed to be lost."""
FLOOR, SAFETY = 0.04, 2.0
"""The assumed loss: twice the counted one, at least 4 %, because losses come in bursts."""
MOST = 0.9
OUTAGE = 5
"""A pause of more periods is not a loss of frames."""
JITTER, JITTER_MIN, JITTER_MAX, FORGET = 0.1, 0.025, 0.5, 0.98
"""In periods: the first guess, the bounds, and what is left of the largest deviation a heartbeat later."""
SURE = math.log(1e4)
FEWEST_MISSED, MORE_THAN_EVER = 3, 2
"""A single peer is lost after this many missed heartbeats, and this many more than the recent maximum."""
RUNS = 300


@dataclass(slots=True)
class HeartbeatStats:
    """Of one peer. `period_s`: between its heartbeats, unlike an average of gaps not longer where frames are lost. It begins
    with our own period, and is never shorter: what comes by two ways, or from two agents, comes more often."""

    period_s: float
    least_s: float = field(init=False)
    jitter: float = JITTER
    """The largest deviation of a heartbeat from its time lately, in periods."""
    received: float = 0.0
    lost: float = 0.0
    pauses: float = 0.0
    """Counted over MEMORY: heartbeats that came, that did not, and gaps in which some did not."""
    _gaps: deque[float] = field(default_factory=lambda: deque(maxlen=GAPS), repr=False)
    _runs: deque[int] = field(default_factory=lambda: deque(maxlen=RUNS), repr=False)

    def __post_init__(self) -> None:
        self.least_s = self.period_s

    def add_gap(self, gap_s: float) -> None:
        """A heartbeat was received `gap_s` after the one before."""
        self._gaps.append(gap_s)
        ordered = sorted(self._gaps)
        self.period_s = max(self.least_s, ordered[len(ordered) // 2])
        periods = gap_s / self.period_s
        missed = max(0, round(periods) - 1)
        self._runs.append(missed)
        if missed >= OUTAGE:
            return
        keep = 1.0 - 1.0 / MEMORY
        self.received, self.lost = self.received * keep + 1.0, self.lost * keep + missed
        self.pauses = self.pauses * keep + (missed > 0)
        off = abs(periods - missed - 1.0)
        self.jitter = min(JITTER_MAX, max(JITTER_MIN, self.jitter * FORGET, off))

    @property
    def loss_probability(self) -> float:
        """Assumed probability that a heartbeat is lost by chance."""
        counted = (self.lost + PRIOR_LOST) / (self.received + self.lost + PRIOR_LOST + PRIOR_RECEIVED)
        return min(MOST, max(FLOOR, SAFETY * counted))

    @property
    def repeated_loss_probability(self) -> float:
        """Assumed probability that another one is lost after a lost one: fades affect several."""
        lost = self.loss_probability
        return min(MOST, max(lost, (self.lost - self.pauses + PRIOR_LOST * lost) / (self.lost + PRIOR_LOST)))

    def weight(self, missed: int) -> float:
        """Evidence of this many missed in a row: the negative logarithm of their probability by chance."""
        return (
            -math.log(self.loss_probability) - (missed - 1) * math.log(self.repeated_loss_probability)
            if missed
            else 0.0
        )

    @property
    def slack_s(self) -> float:
        """A heartbeat later than this is missed."""
        return max(2.0 * JITTER_MIN, min(JITTER_MAX, 1.5 * self.jitter)) * self.period_s

    def missed(self, silent_s: float) -> int:
        """How many heartbeats are overdue by now."""
        if silent_s < self.period_s:
            return 0  # most are silent for less, and there may be hundreds
        return max(0, math.floor((silent_s - self.slack_s) / self.period_s))

    def is_lost(self, missed: int) -> bool:
        """Whether so many missed heartbeats prove that it is lost: only if it was received regularly."""
        if missed < FEWEST_MISSED or self.weight(missed) < SURE:
            return False
        return missed >= MORE_THAN_EVER + max(self._runs, default=0)
