"""The path of a command from the ground to the autopilot: hops in order, and where it stops. Pure.

A hop is the result of one check for one section of the path. Not a check: files in this folder whose names start with an
underscore are parts of checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from phm import api
from phm.api import Level
from phm_checks._text import clean

QUIET_S = 2.5
"""Every MAVLink component sends one HEARTBEAT per second; two of them may be lost."""

START_S = 30.0
"""Router, radio and autopilot are switched on together with the companion computer and may take this long to start: until then, a
device that was never received does not count as missing."""
REBOOTING_S = 30.0
"""An autopilot that acknowledged a reboot is back within this time. Measured, ArduCopter without a sensor calibration: 6 to 7 s."""
OBEYS_S = 3.0
"""It falls silent within this time after the acknowledgement, or the command was for something else."""


class HopState(Enum):
    """UNUSED: the hop does not exist, or nothing was ever received from it. WEAK: frames pass, but something is wrong with it."""

    OK = "ok"
    WEAK = "weak"
    BROKEN = "BROKEN"
    UNKNOWN = "unknown"
    UNUSED = "not used"


@dataclass(frozen=True, slots=True)
class Hop:
    """evidence: a few words for the operator. behind: the hops through which it is observed, the nearest to PHM first; if one of
    them is broken, nothing is known about this hop."""

    name: str
    state: HopState
    evidence: str = ""
    behind: tuple[str, ...] = ()


def hop(name: str, result: api.Result, behind: Sequence[str] = ()) -> Hop:
    """Convert a check's result into the hop for its section of the path."""
    if result.bypass:
        return Hop(name, HopState.UNUSED)
    states = {
        Level.OK: HopState.OK,
        Level.WARN: HopState.WEAK,
        Level.ERROR: HopState.BROKEN,
        Level.STALE: HopState.UNKNOWN,
    }
    words = result.brief or (result.summary if result.level is Level.STALE else "")
    subject, _, rest = words.partition(": ")
    return Hop(
        name, states[result.level], rest if rest and subject.startswith(name) else clean(words, 60), tuple(behind)
    )


def seen_from_here(hops: Sequence[Hop]) -> list[Hop]:
    """Mark hops behind a broken hop as unknown, whatever their own evidence says: no data from them reaches PHM."""
    broken = {one.name for one in hops if one.state is HopState.BROKEN}
    return [_seen(one, next((name for name in one.behind if name in broken), "")) for one in hops]


def _seen(one: Hop, behind: str) -> Hop:
    if not behind or one.state in (HopState.OK, HopState.UNUSED):
        return one
    return replace(one, state=HopState.UNKNOWN, evidence=f"behind {behind}")


def first_broken(hops: Sequence[Hop]) -> Hop | None:
    """The hop at which a command stops; None if no broken hop is known."""
    return next((one for one in hops if one.state is HopState.BROKEN), None)


def in_words(hops: Sequence[Hop]) -> str:
    """``GCS ok -> radio BROKEN (no RADIO_STATUS 6 s) -> ...``; unused hops are omitted."""
    used = (one for one in hops if one.state is not HopState.UNUSED)
    return " -> ".join(f"{one.name} {one.state.value}{f' ({one.evidence})' if one.evidence else ''}" for one in used)


# ---------------------------------------------------------------- the existing hops


def link_id(entry: api.EndpointSettings) -> str:
    """The unit id of an endpoint."""
    return f"link/{api.topic_id(entry.key)}"


def radio_id(entry: api.EndpointSettings) -> str:
    """The unit id of the radio behind an endpoint."""
    return f"radio/{api.topic_id(entry.key)}"


def target_of(link: str) -> str:
    """The recovery target for the endpoint with this name."""
    return f"link:{link}"


def to_ground(settings: api.Settings) -> list[api.EndpointSettings]:
    return [entry for entry in settings.mavlink.endpoints if entry.to_ground]


def to_autopilot(settings: api.Settings) -> list[api.EndpointSettings]:
    return [entry for entry in settings.mavlink.endpoints if entry.to_autopilot]


def ways(settings: api.Settings) -> list[api.EndpointSettings]:
    """Endpoints through which a command from the ground may pass; not the endpoints to other agents."""
    return [entry for entry in settings.mavlink.endpoints if entry.to_ground or entry.to_autopilot]


def with_radio(settings: api.Settings) -> list[api.EndpointSettings]:
    """Endpoints behind which PHM expects or looks for a radio."""
    return [
        entry
        for entry in settings.mavlink.endpoints
        if entry.radio == "required" or (entry.radio == "auto" and entry.to_ground)
    ]


def kind(entry: api.EndpointSettings) -> str:
    """The name of the endpoint's hop."""
    return "port" if entry.serial else "router" if entry.leads_to == "router" else "link"


def named(hop_name: str, entry: api.EndpointSettings, entries: Sequence[api.EndpointSettings]) -> str:
    """The hop's name, such as `radio`, followed by the endpoint's name if there are several."""
    return hop_name if list(entries) == [entry] else f"{hop_name} {entry.key}"


# ---------------------------------------------------------------- endpoint queries that several checks share


def link_of(world: api.World, name: str) -> api.LinkFact | None:
    """The state of an endpoint; None if PHM has not tried it yet."""
    return next((link for link in world.links.links() if link.name == name), None)


def silent(link: api.LinkFact | None) -> bool:
    """Whether the endpoint is open but receives nothing at all."""
    return link is not None and link.open and (link.rx_age_s is None or link.rx_age_s >= QUIET_S)


def reboots_on_command(fact: api.AutopilotFact | None) -> bool:
    """Whether the autopilot reboots on command, as far as is known. ArduPilot refuses that while armed."""
    if fact is None or fact.rebooting_s is None or fact.rebooting_s > REBOOTING_S or fact.armed:
        return False
    return fact.rebooting_s < OBEYS_S or fact.age_s > fact.rebooting_s - OBEYS_S


def routed(world: api.World, entry: api.EndpointSettings) -> bool:
    """Whether there is a router: configured, or detected by a RADIO_STATUS, which no autopilot forwards."""
    if entry.leads_to != "both" or entry.serial:
        return entry.leads_to == "router"
    return any(radio.link == entry.key for radio in world.links.radios())


def starting(world: api.World) -> bool:
    """Whether PHM started only recently, so that other parts of the vehicle may still be starting."""
    return world.daemon.snapshot().uptime_s < START_S


def all_closed(world: api.World, entries: Sequence[api.EndpointSettings]) -> bool:
    """Whether all these endpoints are known to be closed: then nothing can be received."""
    closed = {link.name for link in world.links.links() if not link.open}
    return all(entry.key in closed for entry in entries)
