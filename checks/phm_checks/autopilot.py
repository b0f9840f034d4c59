"""Slot 10: the autopilot sends heartbeats and has not rebooted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Slot
from phm_checks._command_path import (
    REBOOTING_S,
    all_closed,
    link_id,
    link_of,
    reboots_on_command,
    routed,
    silent,
    starting,
    target_of,
    to_autopilot,
)
from phm_checks._text import StableNumber, brief, span

REPORT_S = 30.0
"""A reboot is reported for this long, so that a ground station with a short interruption receives it too."""
SETTLE_S = 1.5
"""When the router or radio on the way fails, its last frame from other senders may come up to a second later. Not used
while other frames still arrive, nor with nothing between the autopilot and PHM."""
SAMPLED_S = 0.5
"""Accuracy of the time of the last frame from other senders."""
GRACE_S = 5.0
NOW_S = 1.5
"""A sender whose last frame is younger still sends: a HEARTBEAT comes once a second."""


class Autopilot(api.Check):
    """The vehicle's autopilot. PHM must report its loss: PHM's heartbeats keep the ground station's link timer running."""

    name, slot, layer = "autopilot", Slot.AUTOPILOT, Layer.LINK
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._settings = settings
        self._links = to_autopilot(settings)
        self._age = StableNumber(share=1.0)
        self._lost_at: int | None = None
        """The reboots that were known when it was lost; None: it has not been lost since it was last OK."""
        self._back = False
        """It has been received since, and the end of that loss was reported."""
        self._alone = False
        """Since it was last received, others were received in time: a lack of CPU time delays all frames of a link."""

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if to_autopilot(settings) else []

    @property
    def units(self) -> Sequence[api.Unit]:
        target = target_of(self._links[0].key) if len(self._links) == 1 else ""
        needs = tuple(link_id(entry) for entry in self._links)
        return (api.Unit("autopilot", needs=needs, target=target, settle_s=SETTLE_S, grace_s=GRACE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        fact, limits = world.links.autopilot(), self._settings.mavlink
        if fact is None and not starting(world) and (other := self._other(world)):
            return self._misnamed(*other)
        if fact is None and not limits.autopilot:
            words = "no autopilot heartbeat received, and none is expected (mavlink.autopilot)"
            return api.bypass(words).with_evidence(api.Evidence(unobserved=True))
        if fact is not None and reboots_on_command(fact):
            return self._awaited(fact)
        if (fact is None or fact.overdue or fact.silent_s > limits.autopilot_timeout) and all_closed(
            world, self._links
        ):
            return api.stale("autopilot state unknown: every link to it is closed")
        if fact is None and starting(world):
            return api.stale("no autopilot heartbeat received yet")
        if fact is None or fact.silent_s > limits.autopilot_timeout:
            return self._lost(world, fact)
        if fact.overdue and self._certain(world, fact):
            return self._lost(world, fact, early=True)
        self._age.forget("age")
        self._back, self._alone = True, False
        ended_by = "reboot" if self._lost_at is not None and fact.reboots > self._lost_at else ""
        if fact.rebooted_s is not None and fact.rebooted_s <= REPORT_S:
            # The autopilot's own messages show the reboot, so no other component can be the cause.
            found = replace(_rebooted(fact, fact.rebooted_s, _values(fact)), settle_s=0.0)
            return found.with_evidence(api.Evidence(certain=True, ended_by=ended_by))
        self._lost_at = None
        flying = "armed" if fact.armed else "disarmed"
        words = f"last autopilot heartbeat {span(fact.age_s)} ago, {flying}, mode {fact.custom_mode}"
        return api.ok(words, values=_values(fact)).with_evidence(api.Evidence(ended_by=ended_by))

    def _other(self, world: api.World) -> tuple[int, str] | None:
        """The system as which the autopilot sends instead of `agent.id`, and the link. None where it may be another vehicle: only
        the autopilot itself is at the other end of these links, and none has a radio."""
        entries = (one for one in self._links if one.leads_to == "autopilot" or (one.serial and one.leads_to == "both"))
        direct = {entry.key for entry in entries} - {radio.link for radio in world.links.radios()}
        senders = [(one, link.name) for link in world.links.links() if link.name in direct for one in link.senders]
        gcs, own = world.links.gcs(), self._settings.agent.id
        found = {
            one.system: link
            for one, link in senders
            if one.component == 1 and one.age_s <= self._settings.mavlink.autopilot_timeout
        }
        if len(found) != 1 or any(one.system == own for one, _ in senders) or (gcs is not None and gcs.system in found):
            return None
        return next(iter(found.items()))

    def _misnamed(self, system: int, link: str) -> api.Result:
        own = self._settings.agent.id
        make = api.error if self._settings.mavlink.autopilot else api.warn
        return make(
            f"autopilot {system} is received on {link}, agent.id is {own}: set agent.id (PHM_AGENT_ID) to {system}, or the "
            f"autopilot's system id to {own}",
            brief=brief("autopilot:", f"id {system}, agent.id {own}"),
            condition="autopilot_silent",
        )

    def _certain(self, world: api.World, fact: api.AutopilotFact) -> bool:
        """Whether no link, router or radio on the way can be the cause."""
        entry = next((entry for entry in self._links if entry.key == fact.link), None)
        link = link_of(world, fact.link)
        if entry is None or link is None or not link.open:
            return False
        return not routed(world, entry) or self._others(world, fact)

    def _others(self, world: api.World, fact: api.AutopilotFact, newest_s: float = float("inf")) -> bool:
        """Whether its link has carried frames from other senders since its own stopped, the last one at most `newest_s` ago."""
        link, quiet_s = link_of(world, fact.link), fact.age_s if fact.quiet_s is None else fact.quiet_s
        own = (self._settings.agent.id, 1)
        return link is not None and any(
            one.age_s + SAMPLED_S < quiet_s and one.age_s <= newest_s
            for one in link.senders
            if (one.system, one.component) != own
        )

    def _begin_loss(self, fact: api.AutopilotFact) -> None:
        """A reboot that was reported before this loss does not end it."""
        if self._lost_at is None or self._back:
            self._lost_at, self._back = fact.reboots, False

    def _awaited(self, fact: api.AutopilotFact) -> api.Result:
        """It reboots on command: neither lost nor known to be OK."""
        self._begin_loss(fact)
        found = api.warn(
            f"the autopilot acknowledged a command to reboot {span(fact.rebooting_s or 0.0)} ago, expected to be back within "
            f"{span(REBOOTING_S)}",
            brief="autopilot rebooting",
            condition="autopilot_rebooted",
            values=_values(fact),
        )
        return replace(found, settle_s=0.0)

    def _lost(self, world: api.World, fact: api.AutopilotFact | None, *, early: bool = False) -> api.Result:
        if fact is not None:
            self._begin_loss(fact)
        limit_s = self._settings.mavlink.autopilot_timeout
        if early and fact is not None and fact.due_s is not None:
            limit_s = fact.due_s
        name = fact.link if fact is not None else self._links[0].key if len(self._links) == 1 else ""
        nothing = bool(name) and silent(link_of(world, name))
        if early and fact is not None:
            nothing = not self._others(world, fact)
        if fact is None:
            when, shown = "since PHM's start", ""
        else:
            when, shown = f"for {span(fact.age_s)}", f" {self._age.show('age', fact.age_s):.0f} s"
        more_words = ""
        if fact is not None and fact.armed:
            more_words = " It was armed at its last heartbeat."
        elif fact is not None and fact.age_s < REBOOTING_S:
            more_words = " It was disarmed and may be rebooting, which takes some seconds."
        more = f"nothing else is received on {name} either" if nothing else "other frames are still received"
        found = api.error(
            f"no autopilot heartbeat {when}, expected one within {span(limit_s)}, and {more}: check its power and the "
            f"cable to it.{more_words}",
            brief=brief("autopilot:", f"no heartbeat{shown}"),
            condition="autopilot_silent",
            target=target_of(name) if nothing else "",
            values={} if fact is None else _values(fact),
        )
        if fact is None or not self._certain(world, fact):
            return found
        self._alone = self._alone or (
            fact.silent_s > self._settings.mavlink.autopilot_timeout and self._others(world, fact, NOW_S)
        )
        return replace(found, settle_s=0.0).with_evidence(api.Evidence(conclusive=self._alone))


def _rebooted(fact: api.AutopilotFact, ago_s: float, values: dict[str, api.Value]) -> api.Result:
    """ERROR if it was armed, WARN on the ground."""
    words = f"the autopilot rebooted {span(ago_s)} ago, as its own messages show"
    if fact.rebooted_armed:
        return api.error(
            f"{words}, while it was armed: check the vehicle and the autopilot's power supply",
            brief="autopilot rebooted while armed",
            condition="autopilot_rebooted",
            values=values,
        )
    return api.warn(
        f"{words}; check its power supply unless the reboot was intended",
        brief="autopilot rebooted",
        condition="autopilot_rebooted",
        values=values,
    )


def _values(fact: api.AutopilotFact) -> dict[str, api.Value]:
    return {
        "autopilot_age_s": round(fact.age_s, 1),
        "armed": fact.armed,
        "mode": fact.custom_mode,
        "system_status": fact.system_status,
        "boot_s": None if fact.boot_s is None else round(fact.boot_s, 1),
        "reboots": fact.reboots,
        "link": fact.link,
    }
