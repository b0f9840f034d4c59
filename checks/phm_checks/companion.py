"""Slot 1: PHM itself is alive and the ground hears and is heard."""

from __future__ import annotations

from collections.abc import Iterable

from phm import api
from phm.api import Layer, Slot
from phm_checks._words import Steady, brief, clean, joined, listed, span


class Companion(api.Check):
    """The companion computer: PHM's own parts, its MAVLink links, and the ground station's heartbeat."""

    name, slot, layer = "companion", Slot.COMPANION, Layer.COMPANION
    period_s = 1.0

    def __init__(self, gcs_timeout_s: float) -> None:
        self._gcs_timeout_s = gcs_timeout_s
        self._age = Steady(share=1.0)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings.mavlink.gcs_timeout)]

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        """Everything wrong in one summary; the ground station's silence weighs most."""
        facts = world.myself.look()
        findings = [self._ground(world), *self._own(facts), *self._links(world)]
        bad = [finding for finding in findings if finding.level.bad]
        values: dict[str, api.Value] = {
            "uptime_s": round(facts.uptime_s, 1),
            "ros_restarts": facts.ros_restarts,
            **findings[0].values,
        }
        if not bad:
            return api.ok(f"Companion Computer is running aboard agent; {findings[0].summary}", **values)
        first = api.worst(bad)
        summary = joined([finding.summary for finding in bad])
        return api.Result(first.level, summary, first.brief, first.condition, values=values)

    def _ground(self, world: api.World) -> api.Result:
        age = world.links.gcs_age_s()
        if age is None:
            return api.ok("no ground station heard yet", gcs_age_s=None)
        values: dict[str, api.Value] = {"gcs_age_s": round(age, 1)}
        if age <= self._gcs_timeout_s:
            self._age.forget("gcs")
            return api.ok(f"ground station heard {span(age)} ago", **values)
        return api.error(
            f"no heartbeat of a ground station for {span(age)}, expected one within {span(self._gcs_timeout_s)}: "
            "check the radio, its power and the ground station",
            brief=f"no GCS {span(self._age.show('gcs', age))}",
            condition="gcs_lost",
            target="",
            **values,
        )

    @staticmethod
    def _links(world: api.World) -> list[api.Result]:
        return [
            api.warn(
                f"MAVLink endpoint {clean(link.name, 80)} is closed ({clean(link.error) or 'no reason given'}); "
                "it is reopened as soon as it can be: check its cable, address or device",
                brief=brief(link.name, "closed"),
                condition="link_closed",
            )
            for link in world.links.links()
            if not link.open
        ]

    @staticmethod
    def _own(facts: api.SelfFact) -> list[api.Result]:
        found = []
        if facts.overdue:
            found.append(
                api.warn(
                    f"checks of PHM have not come back in time: {listed(facts.overdue)}; what they watch is unknown",
                    brief=brief(facts.overdue[0], "overdue"),
                    condition="check_overdue",
                )
            )
        lost = {name: count for name, count in facts.dropped.items() if count > 0}
        if lost:
            found.append(
                api.warn(
                    f"events were lost because a reporter was too slow: "
                    f"{listed(f'{name} {count}' for name, count in lost.items())}",
                    brief=brief(next(iter(lost)), "events lost"),
                    condition="events_lost",
                )
            )
        found += [
            api.warn(f"PHM: {clean(problem)}", brief=brief("PHM", clean(problem, 34)), condition="phm_problem")
            for problem in facts.problems
        ]
        return found
