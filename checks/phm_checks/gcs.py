"""Slot 1: heartbeats of the ground station arrive."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm import api
from phm.api import Layer, Slot
from phm_checks._command_path import QUIET_S, all_closed, link_id, radio_id, to_autopilot, to_ground, with_radio
from phm_checks._text import StableNumber, brief, span

SAME_S = 0.3
"""Two times that differ by less belong to the same heartbeat."""
GRACE_S = 5.0
"""Time for the first heartbeat, sent once a second, after a link or a radio is back."""
NOW_S = 1.5
"""A radio whose last RADIO_STATUS is younger still reports: one comes once a second."""
TOGETHER_S = 2.5
"""The last RADIO_STATUS may come so much later than the last heartbeat through that radio: heartbeats come once a second,
and some are lost."""


class Gcs(api.Check):
    """The ground station's heartbeat, received on any link."""

    name, slot, layer = "gcs", Slot.COMPANION, Layer.LINK
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._settings = settings
        self._age = StableNumber(share=1.0)
        self._lost_at: float | None = None
        """Time of the last heartbeat of a ground station reported as lost before the timeout."""
        self._alone = False
        """Since the last heartbeat the onboard radio reported in time that it receives nothing: not a matter of CPU time."""

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if to_ground(settings) else []

    @property
    def units(self) -> Sequence[api.Unit]:
        """The unit depends on the autopilot only if the autopilot forwards the ground station's frames."""
        ground, radios = to_ground(self._settings), with_radio(self._settings)
        through = any(entry.leads_to == "both" for entry in to_autopilot(self._settings))
        needs = [*(link_id(entry) for entry in ground), *(radio_id(entry) for entry in radios)]
        return (api.Unit("gcs", needs=(*needs, *(("autopilot",) if through else ())), grace_s=GRACE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        fact, limit_s = world.links.gcs(), self._settings.mavlink.gcs_timeout
        if fact is None:
            found = api.bypass("no ground station heartbeat received yet", values={"gcs_age_s": None})
            return found.with_evidence(api.Evidence(unobserved=True))
        if fact.left:
            return api.bypass("the last ground station has announced its end", values={"gcs_age_s": None})
        values: dict[str, api.Value] = {
            "gcs_age_s": round(fact.age_s, 1),
            "gcs": f"{fact.system}/{fact.component}",
            "link": fact.link,
        }
        if fact.silent_s <= limit_s and not self._early(world, fact):
            self._age.forget("gcs")
            self._alone = False
            return api.ok(f"last ground station heartbeat {span(fact.age_s)} ago", values=values)
        if all_closed(world, to_ground(self._settings)):
            words = "ground station state unknown: every link to the ground is closed"
            return api.stale(words, values=values)
        if not _alone(world, fact) and self._radio_due(world, fact):
            words = f"no ground station heartbeat for {span(fact.age_s)}, and no report from the onboard radio since, which is due"
            return api.stale(words, values=values)
        expected_s = fact.due_s if fact.overdue and fact.due_s is not None else limit_s
        found = api.error(
            f"no ground station heartbeat for {span(fact.age_s)}, expected one within {span(expected_s)}: "
            f"{self._advice(world, fact)}",
            brief=brief("GCS:", f"no heartbeat {self._age.show('gcs', fact.age_s):.0f} s"),
            condition="gcs_lost",
            values=values,
        )
        self._alone = self._alone or _alone(world, fact, NOW_S)
        return found.with_evidence(api.Evidence(conclusive=self._alone))

    def _early(self, world: api.World, fact: api.GcsFact) -> bool:
        """Whether it is certainly lost, before the timeout.

        With a radio that reports the state of the remote radio, that report decides: radio loss comes in bursts, and a
        ground station program may hang briefly. On other links an unusually long pause decides.
        """
        received_at = world.clock.mono() - fact.age_s
        if self._lost_at is not None and received_at - self._lost_at < SAME_S:
            return True  # until its next heartbeat, regardless of later radio reports
        self._lost_at = received_at if self._surely(world, fact) else None
        return self._lost_at is not None

    def _surely(self, world: api.World, fact: api.GcsFact) -> bool:
        if any(
            radio.link == fact.link and (radio.alone or radio.remrssi is not None) for radio in world.links.radios()
        ):
            return _alone(world, fact)
        return fact.overdue and not self._radio_due(world, fact)

    def _radio_due(self, world: api.World, fact: api.GcsFact) -> bool:
        """Whether the radio fell silent at the same time, so that it may be the cause; its reporting period decides when that
        is known."""
        judged = {entry.key for entry in with_radio(self._settings)} & {fact.link}
        return any(radio.link in judged and radio.age_s >= fact.age_s - TOGETHER_S for radio in world.links.radios())

    @staticmethod
    def _advice(world: api.World, fact: api.GcsFact) -> str:
        """The remedy, without components that are known to work."""
        if _alone(world, fact):
            return (
                "the onboard radio responds but receives nothing from the ground radio, so check that one, the antennas and "
                "the distance"
            )
        responding = (radio for radio in world.links.radios() if radio.link == fact.link and radio.age_s < fact.age_s)
        radio = next(responding, None)
        if radio is None:
            return "check the radio, its power and the ground station"
        return (
            f"the onboard radio responds ({span(radio.age_s)} ago), so check the ground radio, the distance, and the "
            "ground station"
        )


def _alone(world: api.World, fact: api.GcsFact, newest_s: float = float("inf")) -> bool:
    """Whether the onboard radio reports, at most `newest_s` ago, that it receives nothing from the ground radio; damaged frames alone
    do not count.
    """
    if fact.silent_s <= QUIET_S:
        return False
    return any(
        radio.alone and radio.link == fact.link and radio.age_s < fact.age_s and radio.age_s <= newest_s
        for radio in world.links.radios()
    )
