"""Whether a sender is alive, by its received heartbeats and the ground's own clock. Pure.

The ground does not know heartbeat periods: agents choose theirs by the size of the swarm, and radios lose frames. So the usual
pause is learned from the longer ones: loss doubles some, and an answer to a ground station or a second link shortens some.
"""

from __future__ import annotations

import math
from collections import deque
from enum import Enum

from phm.swarm.peers import LATE_PERIODS, LOST_PERIODS

GAPS, ENOUGH, LONGER = 9, 3, 0.75
"""Gaps that are kept, that are enough for an estimate, and the quantile that counts."""
COPY_S = 0.1
"""Heartbeats with a shorter gap are copies, not a period."""
LONGEST_S = 150.0


class PresenceState(str, Enum):
    NEVER = "never received"
    ALIVE = "alive"
    LATE = "late"
    LOST = "lost"
    LEFT = "left"
    """It announced that it was stopped on purpose."""

    @property
    def there(self) -> bool:
        return self in (PresenceState.ALIVE, PresenceState.LATE)


class Presence:
    """The presence of one sender. Times are monotonic seconds of the ground."""

    def __init__(self) -> None:
        self.received_s: float | None = None
        self.leaving = False
        self._gaps: deque[float] = deque(maxlen=GAPS)
        self._was_lost = False
        """Since the last usual pause there was one as long as a loss."""

    def heartbeat(self, now: float, *, leaving: bool = False) -> None:
        """A heartbeat was received; `leaving`: it is the last one."""
        if self.received_s is not None and not self.leaving:
            gap_s = now - self.received_s
            if COPY_S < gap_s <= LONGEST_S and not self._is_outage(gap_s):
                self._gaps.append(gap_s)
        self.received_s, self.leaving = now, leaving

    def period_s(self, guess_s: float) -> float:
        """Its usual pause; before that is known, the longer of the guess and the observed gaps."""
        if len(self._gaps) < ENOUGH:
            return max(guess_s, *self._gaps, 0.0)
        return sorted(self._gaps)[int(LONGER * len(self._gaps))]

    def _is_outage(self, gap_s: float) -> bool:
        """Whether a gap is the first one as long as a loss: the second in sequence is another period, of a swarm that grows."""
        usual_s = self.period_s(0.0) if len(self._gaps) >= ENOUGH else math.inf
        if gap_s > LOST_PERIODS * usual_s:
            first, self._was_lost = not self._was_lost, True
            return first
        if gap_s > usual_s / 2:  # a shorter one is an additional heartbeat or came by another link
            self._was_lost = False
        return False

    def silent_s(self, now: float) -> float | None:
        return None if self.received_s is None else max(0.0, now - self.received_s)

    def state(self, now: float, guess_s: float) -> PresenceState:
        silent_s = self.silent_s(now)
        if silent_s is None:
            return PresenceState.NEVER
        if self.leaving:
            return PresenceState.LEFT
        period_s = self.period_s(guess_s)
        if silent_s > LOST_PERIODS * period_s:
            return PresenceState.LOST
        return PresenceState.LATE if silent_s > LATE_PERIODS * period_s else PresenceState.ALIVE
