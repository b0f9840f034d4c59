"""The lives of one container: whether it stays, or is started again and again.

A life is short when it ends before the container has run for `steady_s`. Some short lives in a row are a loop, and the
loop is over when one life is not short: one fault, whether the container happens to run at a look or not.
"""

from __future__ import annotations

from phm import api

STABLE_S = 12.0
"""Longer than Docker's own measure, 10 s, after which its restart policy waits no longer than at first, and than what mutes
the parts of a container: 11 s after it was told to end. So what never comes well is told, inside or at the container."""
ENGINE_RESTARTS = 3
"""So many restarts in a row by the engine's restart policy, each after a short life, are a loop."""
OTHER_STARTS = 6
"""The same for starts by anybody else. The check knows no hands apart: it is more than PHM's own budget allows."""
WAIT_S = 2.0
"""The engine waits 0.1 s before the first restart and twice as long each time: a longer wait comes after several."""


class RestartLoop:
    """What the looks at one container add up to."""

    def __init__(self, steady_s: float, limit_by_hand: int) -> None:
        self.steady_s = steady_s
        self.steady = False
        """This life has lasted for `steady_s`, as far as it was seen."""
        self.by_engine = 0
        """Restarts by the engine in a row, since a life that was not short or a start by hand."""
        self.by_hand = 0
        self._limit_by_hand = limit_by_hand
        self._waited_long = False
        self._seen: api.ContainerFact | None = None
        self._runs_since: float | None = None
        self._waits_since: float | None = None

    @property
    def looping(self) -> bool:
        return self.by_engine >= ENGINE_RESTARTS or self.by_hand >= self._limit_by_hand or self._waited_long

    def look(self, fact: api.ContainerFact, now: float) -> None:
        """Take what was seen at `now` (monotonic seconds)."""
        if self._seen is not None:
            self._count(fact, self._seen)
        elif fact.status == "restarting":
            self.by_engine = fact.restart_count
        self._seen = fact
        if fact.running:
            self._runs_since = now if self._runs_since is None else self._runs_since
            self.steady = now - self._runs_since >= self.steady_s
        if fact.status != "restarting":
            self._waits_since = None
        elif self._waits_since is None:
            self._waits_since = now
        elif now - self._waits_since >= WAIT_S:
            self._waited_long = True
        if self.steady:
            self._begin_counting()

    def _count(self, fact: api.ContainerFact, before: api.ContainerFact) -> None:
        """The engine's counter also tells of lives that nobody saw; a start by anybody else sets it to 0."""
        risen, reborn = fact.restart_count - before.restart_count, fact.generation != before.generation
        if not reborn and risen <= 0:
            return
        if self.steady:
            self._begin_counting()
        self.steady, self._runs_since = False, None
        if risen > 0:
            self.by_engine += risen
        elif risen < 0 or fact.restart_count == 0:
            self.by_engine, self._waited_long = fact.restart_count, False
            self.by_hand += 1

    def _begin_counting(self) -> None:
        self.by_engine = self.by_hand = 0
        self._waited_long = False
