"""Slot 2: the result of the container's HEALTHCHECK."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from phm import api
from phm.api import Slot
from phm_checks._hanging_probe import HangingProbe, usual_s
from phm_checks._per_container import PerContainer
from phm_checks._text import brief, clean, span

UNDISTURBED_S = 5.0
"""A probe that failed although nothing had delayed it for this long counts, whatever delayed it before: the time that symptoms of
starvation have to disappear (docs/development/architecture.md)."""


IN_TIME_S, IN_TIME_PROBES = 1.0, 2
"""So many probes in a row that failed by themselves within this time: the engine started a program in the container, and it ran to
its end, without delay. So a busy CPU of the machine has not delayed this container much. What its own pressure unit reports still
explains the failure: the probe may ask how old the application's data are."""
OWN_CODES = range(1, 128)
"""Exit codes of a program that ended by itself; above them are signals, e.g. of the kernel for lack of memory."""
SETTLE_S = 2.0
"""A run that hangs is reported after this time: after the entire machine was suspended, the engine starts a run immediately."""


class Health(PerContainer):
    """Docker's health state of the container."""

    name, slot = "health", Slot.CONTAINER
    period_s = 5.0
    """No event signals that a run of the HEALTHCHECK hangs."""

    def __init__(self, entry: api.ContainerSettings) -> None:
        super().__init__(entry)
        self._hanging = HangingProbe()
        self._probed: object = None
        self._polled_at = self._shown_from = float("-inf")

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        return entry.healthcheck != "ignore"

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, needs=(f"container/{self.key}",), target=self.key),)

    def run(self, world: api.World) -> api.Result:
        asked_at = world.clock.mono()
        try:
            fact = world.docker.container(self.key)
        except api.CannotTell:
            self._hanging.not_described()
            raise
        hanging_s = self._hanging.hanging_s(fact, asked_at, world.clock.mono())
        shown_from = self._note_probe(fact, world.clock.mono())
        if fact is None or not fact.running:
            return api.stale(f"health of {self.key} is unknown while it is not running")
        output = clean(fact.health_output)
        values: dict[str, api.Value] = {"health": fact.health, "failing_streak": fact.health_streak}
        if fact.healthcheck is not None and hanging_s is not None:
            return self._hangs(fact, fact.healthcheck, hanging_s, values)
        if fact.health == "healthy":
            return api.ok(f"Health check of {self.key} passes", values=values)
        if fact.health == "unhealthy" and fact.health_streak == 0:
            # The engine reports this between the end of a pause and the first probe after it.
            return api.stale(f"health check of {self.key} has not run since the container was paused", values=values)
        if fact.health == "unhealthy":
            times = "once" if fact.health_streak == 1 else f"{fact.health_streak} times in a row"
            unhealthy = api.error(
                f"health check of {self.key} failed {times}, expected healthy. Last output: "
                f"{output or 'none'}. `docker inspect {fact.name}` shows the earlier ones",
                brief=brief(self.key, "unhealthy"),
                condition="unhealthy",
                target=self.key,
                values=values,
            )
            in_time = _failed_in_time(fact)
            return replace(
                unhealthy, age_s=world.clock.mono() - shown_from, evidence=replace(unhealthy.evidence, in_time=in_time)
            )
        if fact.health == "starting":
            decides_s = fact.healthcheck.decides_s if fact.healthcheck is not None else None
            within = f", which may take {span(decides_s)} from its start" if decides_s is not None else ""
            words = f"health check of {self.key} has not decided yet (starting){within}"
            return replace(api.stale(words, values=values), decides_s=decides_s)
        return self._none(values)

    def _note_probe(self, fact: api.ContainerFact | None, now: float) -> float:
        """From when on the engine's newest probe shows the state of the container, at the earliest: the last UNDISTURBED_S of the
        probe, in monotonic seconds; -inf if that is before PHM's first observation.

        A failed probe increases the streak. It ended after PHM's previous observation and may have taken its entire timeout.
        """
        probed = None if fact is None else (fact.generation, fact.health, fact.health_streak)
        if probed != self._probed:
            timeout_s = fact.healthcheck.timeout_s if fact is not None and fact.healthcheck is not None else 0.0
            self._probed, self._shown_from = probed, self._polled_at - min(timeout_s, UNDISTURBED_S)
        self._polled_at = now
        return self._shown_from

    def _hangs(
        self, fact: api.ContainerFact, probe: api.HealthcheckFact, hanging_s: float, values: dict[str, api.Value]
    ) -> api.Result:
        """WARN until the engine has decided. The container is healthy until then: what was wrong before is over."""
        words = (
            f"health check of {self.key} hangs: no run has ended by itself for {span(hanging_s)}, expected one every "
            f"{span(probe.interval_s + usual_s(fact))}. Docker ends a run after its timeout of {span(probe.timeout_s)}, and reports "
            f"{self.key} as unhealthy after {probe.retries} failed runs in a row ({fact.health_streak} so far); "
            f"`docker top {fact.name}` shows what hangs"
        )
        hangs = api.warn(
            words,
            brief=brief(self.key, "health check hangs"),
            condition="healthcheck_hangs",
            target=self.key,
            values=values,
        )
        return replace(hangs, settle_s=SETTLE_S, evidence=api.Evidence(forecast=True))

    def _none(self, values: dict[str, api.Value]) -> api.Result:
        if self.entry.healthcheck != "required":
            return api.bypass(f"No health check defined for {self.key}.", values=values)
        return api.error(
            f"{self.key} has no health check, but the configuration requires one: add HEALTHCHECK to its image or "
            "`healthcheck:` to its compose file, or set `healthcheck: auto`",
            brief=brief(self.key, "no healthcheck"),
            condition="healthcheck_missing",
            target=self.key,
            values=values,
        )


def _failed_in_time(fact: api.ContainerFact) -> bool:
    """Whether the newest probes reported the failure themselves, without delay."""
    newest = fact.failed_probes[-IN_TIME_PROBES:]
    return len(newest) == IN_TIME_PROBES and all(
        probe.exit_code in OWN_CODES and probe.took_s is not None and probe.took_s <= IN_TIME_S for probe in newest
    )
