"""The runs of one container: whether it stays up, or is restarted again and again.

A run is short if it ends before the container has run for `steady_s`. Several short runs in a row are a restart loop, and the
loop is over when one run is not short. That is one fault, whether or not the container happens to be running at a reading.
"""

from __future__ import annotations

from phm import api

STABLE_S = 12.0
"""Longer than Docker's own limit of 10 s, after which its restart policy resets its back-off, and longer than the 11 s for which the
parts of a container are suppressed after a stop was requested. So a container that never becomes healthy is reported, either by its parts
or by the container itself."""
ENGINE_RESTARTS = 3
"""This many restarts in a row by the engine's restart policy, each after a short run, are a loop."""
OTHER_STARTS = 6
"""The same for starts by anyone else. The check cannot distinguish who started it, so this is more than PHM's own budget allows."""
WAIT_S = 2.0
"""The engine waits 0.1 s before the first restart and doubles the wait each time: a wait this long follows several restarts."""


class RestartLoop:
    """Restart-loop detection from successive readings of one container."""

    def __init__(self, steady_s: float, limit_by_hand: int) -> None:
        self.steady_s = steady_s
        self.steady = False
        """Whether the current run has lasted for `steady_s`, as far as it was observed."""
        self.by_engine = 0
        """Consecutive restarts by the engine, since a run that was not short or a start by hand."""
        self.by_hand = 0
        self._limit_by_hand = limit_by_hand
        self._waited_long = False
        self._seen: api.ContainerFact | None = None
        self._runs_since: float | None = None
        self._waits_since: float | None = None

    @property
    def looping(self) -> bool:
        return self.by_engine >= ENGINE_RESTARTS or self.by_hand >= self._limit_by_hand or self._waited_long

    def observe(self, fact: api.ContainerFact, now: float) -> None:
        """Process the container's state at `now` (monotonic seconds)."""
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
        """Count restarts. The engine's counter also includes runs that PHM did not observe; a start by anyone else resets it to 0."""
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
