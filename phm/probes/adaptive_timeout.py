"""Adaptive timeout for a sender of heartbeats, learned from its intervals. Pure; callers pass the time.

A sender that never made a long pause is lost well before the configured timeout. For a sender received for less than
LEARN_S, or with irregular or lost heartbeats, only the configured timeout applies.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from phm.core.scheduling_delay import Late, never_late

FACTOR = 2.2
"""Silence of this many times the longest pause: one more heartbeat than ever before may be lost."""
UNEVEN_S = 2.5
"""After such a pause, equal to two heartbeats lost in a row, the sender or the link is not steady."""
LEARN_S = 120.0
STEP_S, STEPS = 60.0, 60
"""Pauses of the last STEP_S * STEPS seconds count."""


@dataclass(slots=True)
class _Step:
    began: float
    longest_s: float = 0.0
    known_s: float = 0.0


class AdaptiveTimeout:
    """Not thread-safe. most_s: the configured timeout, the upper limit. least_s: the lower limit."""

    def __init__(self, most_s: float, least_s: float = UNEVEN_S) -> None:
        self._most_s, self._least_s = most_s, least_s
        self._steps: deque[_Step] = deque(maxlen=STEPS)
        self._last: float | None = None
        """The newest heartbeat, from which the next pause is measured."""
        self._from = float("-inf")
        """Start of the silence that counts: nothing could be received before."""
        self._held_s = 0.0
        """The newest pause, which `broke` can still remove."""
        self._due_s: float | None = None
        self._lost = False

    def heartbeat(self, now: float, late_s: float = 0.0) -> None:
        """Record a heartbeat. late_s: how much of the pause before it PHM did not run."""
        self._keep(now, self._held_s)
        pause_s = 0.0 if self._last is None else max(0.0, now - self._last - late_s)
        # A longer pause was a fault, not a property of the sender.
        self._held_s = pause_s if pause_s <= self._most_s else 0.0
        self._last, self._from, self._lost = now, now, False
        self._due_s = self._limit_s()

    def broke(self, now: float) -> None:
        """The next heartbeat does not continue the series: the link was closed, PHM was suspended, or the sender
        restarted."""
        self._last, self._from, self._held_s = None, now, 0.0
        self._due_s = self._limit_s()

    def due_s(self) -> float | None:
        """The limit in seconds; None if too little is known, or if it is not below the configured one."""
        return self._due_s

    def overdue(self, read_at: float | None, late_s: Late = never_late) -> bool:
        """Whether the sender was silent for longer than the limit, as far as its link was read completely at `read_at`;
        None: it is not read.

        Once overdue, it stays overdue until its next heartbeat, even if the link closes. late_s: for how long PHM did
        not run.
        """
        due_s = self._due_s
        if due_s is not None and read_at is not None and read_at - self._from > due_s:
            self._lost = self._lost or read_at - self._from - late_s(self._from, due_s) > due_s
        return self._lost

    def _limit_s(self) -> float | None:
        longest_s = max([self._held_s, *(step.longest_s for step in self._steps)])
        if sum(step.known_s for step in self._steps) < LEARN_S or longest_s > UNEVEN_S:
            return None
        limit_s = max(self._least_s, FACTOR * longest_s)
        return limit_s if limit_s < self._most_s else None

    def _keep(self, now: float, pause_s: float) -> None:
        while self._steps and now - self._steps[0].began > STEP_S * STEPS:
            self._steps.popleft()
        if not self._steps or now - self._steps[-1].began >= STEP_S:
            self._steps.append(_Step(now))
        step = self._steps[-1]
        step.longest_s, step.known_s = max(step.longest_s, pause_s), step.known_s + pause_s
