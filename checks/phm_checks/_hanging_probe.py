"""Whether a run of a container's HEALTHCHECK hangs, by how long none has ended."""

from __future__ import annotations

from phm import api

RUNS, LEAST_S = 3.0, 5.0
"""A run counts as hanging once it is late by this many times the longest of the last runs that passed, and by this time at least: on
a busy machine the engine starts a run seconds late, and it takes several times as long."""
ENGINE_LATE_S = 1.0
"""An engine that takes longer to describe a container is late, with its health checks, too."""
TIMED_OUT = -1
SHARE = 0.9
"""A run with the exit code TIMED_OUT that took this share of the timeout was ended by the engine, which has the same code for a run
that it could not start."""


class HangingProbe:
    """The runs of one container's HEALTHCHECK, as the engine logs them. Times are monotonic: those in the engine's log may jump.

    Counted is only time in which the engine answers, and the container runs and is healthy: then the engine runs health checks.
    """

    def __init__(self) -> None:
        self._generation = self._ended = ""
        """The run of the container, and the engine's time stamp of the newest end of a run of its HEALTHCHECK."""
        self._running_since = self._waited_s = 0.0
        self._looked_at: float | None = None
        """When the engine described the container last; None: it has failed to since."""
        self._hangs = False

    def not_described(self) -> None:
        """The engine did not answer."""
        self._looked_at = None

    def hanging_s(self, fact: api.ContainerFact | None, asked_at: float, now: float) -> float | None:
        """How long no run has ended by itself, in seconds, if one hangs; else None. asked_at: when the engine was asked for `fact`."""
        counted_s = 0.0 if self._looked_at is None or now - asked_at > ENGINE_LATE_S else now - self._looked_at
        self._looked_at = now
        if fact is None or not fact.running or fact.health != "healthy" or fact.healthcheck is None:
            self._ended, self._hangs = "", False
            return None
        if fact.generation != self._generation:
            self._generation, self._running_since, self._ended = fact.generation, now, ""
        goes_on = fact.probe_ended == self._ended or (self._hangs and _timed_out(fact, fact.healthcheck))
        self._waited_s = self._waited_s + counted_s if goes_on and self._ended else 0.0
        self._ended = fact.probe_ended
        late_s = self._waited_s - fact.healthcheck.interval_s
        self._hangs = (
            late_s > max(LEAST_S, RUNS * usual_s(fact)) and now - self._running_since >= fact.healthcheck.start_period_s
        )
        return self._waited_s if self._hangs else None


def usual_s(fact: api.ContainerFact) -> float:
    """The longest of the last runs that passed."""
    return max(fact.passed_probes_s, default=0.0)


def _timed_out(fact: api.ContainerFact, healthcheck: api.HealthcheckFact) -> bool:
    """Whether the engine ended the newest run at its timeout."""
    newest = fact.failed_probes[-1] if fact.failed_probes else None
    if newest is None or newest.exit_code != TIMED_OUT:
        return False
    return newest.took_s is not None and newest.took_s >= SHARE * healthcheck.timeout_s
