"""The command path from the ground station to the autopilot, hop by hop, in one sentence.

It shows where a command stops. Its unit raises no alarm: the unit of the broken hop does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Slot
from phm_checks._application_hop import ApplicationHop
from phm_checks._command_path import (
    Hop,
    HopState,
    first_broken,
    hop,
    in_words,
    kind,
    link_id,
    link_of,
    named,
    radio_id,
    seen_from_here,
    to_autopilot,
    to_ground,
    ways,
    with_radio,
)
from phm_checks.autopilot import Autopilot
from phm_checks.gcs import Gcs
from phm_checks.link import Link
from phm_checks.radio import Radio

UNCLEAR = "the application is not part of it: set mavlink.application"


class CommandPath(api.Check):
    """Ground station, radio, port or router, companion, application, autopilot: each hop with its evidence.

    The unit depends on the unit of each hop. While one of these is bad, it is STALE and blocked by it, and the fault of
    the hop lists `path` among its consequences.
    """

    name, slot, layer = "path", Slot.AUTOPILOT, Layer.LINK
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._settings = settings
        self._ground, self._flight, self._radios = to_ground(settings), to_autopilot(settings), with_radio(settings)
        self._ways = ways(settings)
        self._gcs, self._autopilot = Gcs(settings), Autopilot(settings)
        self._links = {entry.key: Link(entry, settings) for entry in settings.mavlink.endpoints}
        self._radio = {entry.key: Radio(entry, settings) for entry in self._radios}
        self._application = ApplicationHop(settings)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if to_ground(settings) and to_autopilot(settings) else []

    @property
    def units(self) -> Sequence[api.Unit]:
        needs = [
            *(link_id(entry) for entry in self._ways),
            *(radio_id(entry) for entry in self._radios),
            "gcs",
            "autopilot",
            *self._application.needs,
        ]
        return (api.Unit("path", needs=tuple(needs)),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        found = self._hops(world)
        hops = seen_from_here(found)
        words = in_words(hops)
        values: dict[str, api.Value] = {one.name: one.state.value for one in hops}
        broken = first_broken(hops)
        if broken is None and found[0].state is HopState.UNKNOWN and found[-1].state is HopState.UNUSED:
            return api.bypass(f"neither a ground station nor an autopilot received yet: {words}", values=values)
        if broken is None:
            return api.ok(f"no broken hop detected on the command path: {words}{self._unclear}", values=values)
        result = api.stale(f"the command path is broken at {broken.name}: {words}", values=values)
        return result.with_evidence(api.Evidence(broken_hop=broken.name))

    def _hops(self, world: api.World) -> list[Hop]:
        ports = [self._name(entry) for entry in self._ground]
        radios = {entry.key: named("radio", entry, self._radios) for entry in self._radios}
        through = ["autopilot"] if any(entry.leads_to == "both" for entry in self._ground) else []
        beyond = [entry for entry in self._flight if entry not in self._ground]
        return [
            _ground(self._gcs.run(world), [*ports, *through, *radios.values()]),
            *(hop(radios[one.key], self._radio[one.key].run(world), [self._name(one)]) for one in self._radios),
            *(self._link(world, entry) for entry in self._ground),
            Hop("companion", HopState.OK),
            *([self._application.evaluate(world)] if self._application.exists else []),
            *(self._link(world, entry) for entry in beyond),
            hop("autopilot", self._autopilot.run(world), [self._name(entry) for entry in self._flight]),
        ]

    def _name(self, entry: api.EndpointSettings) -> str:
        return named(kind(entry), entry, self._ways)

    def _link(self, world: api.World, entry: api.EndpointSettings) -> Hop:
        """The hop of one endpoint. A closed endpoint is broken even if another unit reports why."""
        found, link = hop(self._name(entry), self._links[entry.key].run(world)), link_of(world, entry.key)
        closed = found.state is HopState.UNKNOWN and link is not None and not link.open
        return replace(found, state=HopState.BROKEN) if closed else found

    @property
    def _unclear(self) -> str:
        return f"; {UNCLEAR}" if self._application.unclear else ""


def _ground(result: api.Result, behind: Sequence[str]) -> Hop:
    """The hop of the ground station. Unknown, never unused, before its first heartbeat."""
    return Hop("GCS", HopState.UNKNOWN, "no heartbeat yet") if result.bypass else hop("GCS", result, behind)
