"""The path of a command from the ground to the autopilot: hops in order, and where it stops. Pure.

A hop is what one check says about one part of the way. Not a check: files of this folder that begin with an underscore
are parts of checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from phm import api
from phm.api import Level
from phm_checks._text import clean

QUIET_S = 2.5
"""Whoever speaks MAVLink sends a HEARTBEAT a second; two of them may be lost."""

START_S = 30.0
"""Router, radio and autopilot are switched on with the companion, and may take so long: what was never there is not missed yet."""


class HopState(Enum):
    """UNUSED: there is none, or none was ever heard. WEAK: frames pass, and something is wrong with it."""

    OK = "ok"
    WEAK = "weak"
    BROKEN = "BROKEN"
    UNKNOWN = "unknown"
    UNUSED = "not used"


@dataclass(frozen=True, slots=True)
class Hop:
    """evidence: a few words for the operator. behind: hops, the nearest to PHM first, without which nothing is known of it."""

    name: str
    state: HopState
    evidence: str = ""
    behind: tuple[str, ...] = ()


def hop(name: str, result: api.Result, behind: Sequence[str] = ()) -> Hop:
    """What a check's result says about its part of the way."""
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
    """What lies behind a broken hop is not known, whatever its own evidence says: none of it gets here."""
    broken = {one.name for one in hops if one.state is HopState.BROKEN}
    return [_seen(one, next((name for name in one.behind if name in broken), "")) for one in hops]


def _seen(one: Hop, behind: str) -> Hop:
    if not behind or one.state in (HopState.OK, HopState.UNUSED):
        return one
    return replace(one, state=HopState.UNKNOWN, evidence=f"behind {behind}")


def first_broken(hops: Sequence[Hop]) -> Hop | None:
    """Where a command stops; None: at no hop, as far as is known."""
    return next((one for one in hops if one.state is HopState.BROKEN), None)


def in_words(hops: Sequence[Hop]) -> str:
    """``GCS ok -> radio BROKEN (no RADIO_STATUS 6 s) -> ...``; what is not used is left out."""
    used = (one for one in hops if one.state is not HopState.UNUSED)
    return " -> ".join(f"{one.name} {one.state.value}{f' ({one.evidence})' if one.evidence else ''}" for one in used)


# ---------------------------------------------------------------- which hops there are


def link_id(entry: api.EndpointSettings) -> str:
    """The unit of an endpoint."""
    return f"link/{api.topic_id(entry.key)}"


def radio_id(entry: api.EndpointSettings) -> str:
    """The unit of the radio behind an endpoint."""
    return f"radio/{api.topic_id(entry.key)}"


def target_of(link: str) -> str:
    """What recovery acts on for the endpoint of this name."""
    return f"link:{link}"


def to_ground(settings: api.Settings) -> list[api.EndpointSettings]:
    return [entry for entry in settings.mavlink.endpoints if entry.to_ground]


def to_autopilot(settings: api.Settings) -> list[api.EndpointSettings]:
    return [entry for entry in settings.mavlink.endpoints if entry.to_autopilot]


def ways(settings: api.Settings) -> list[api.EndpointSettings]:
    """Endpoints that a command from the ground may pass; not those to other agents."""
    return [entry for entry in settings.mavlink.endpoints if entry.to_ground or entry.to_autopilot]


def with_radio(settings: api.Settings) -> list[api.EndpointSettings]:
    """Endpoints behind which a radio is looked for."""
    return [
        entry
        for entry in settings.mavlink.endpoints
        if entry.radio == "required" or (entry.radio == "auto" and entry.to_ground)
    ]


def kind(entry: api.EndpointSettings) -> str:
    """What its hop is called."""
    return "port" if entry.serial else "router" if entry.leads_to == "router" else "link"


def named(hop_name: str, entry: api.EndpointSettings, entries: Sequence[api.EndpointSettings]) -> str:
    """`radio`, or with the endpoint's name where there are several."""
    return hop_name if list(entries) == [entry] else f"{hop_name} {entry.key}"


# ---------------------------------------------------------------- what several checks ask of an endpoint


def link_of(world: api.World, name: str) -> api.LinkFact | None:
    """None: it was not tried yet."""
    return next((link for link in world.links.links() if link.name == name), None)


def silent(link: api.LinkFact | None) -> bool:
    """Whether the endpoint is open and nothing at all comes by it."""
    return link is not None and link.open and (link.rx_age_s is None or link.rx_age_s >= QUIET_S)


def routed(world: api.World, entry: api.EndpointSettings) -> bool:
    """Whether a router is there: configured, or seen by a RADIO_STATUS, which no autopilot passes on."""
    if entry.leads_to != "both" or entry.serial:
        return entry.leads_to == "router"
    return any(radio.link == entry.key for radio in world.links.radios())


def starting(world: api.World) -> bool:
    """Whether PHM has begun a moment ago, and what belongs to the vehicle may still be on its way."""
    return world.myself.look().uptime_s < START_S


def all_closed(world: api.World, entries: Sequence[api.EndpointSettings]) -> bool:
    """Whether every one of these endpoints is known to be closed: then nothing can be heard."""
    closed = {link.name for link in world.links.links() if not link.open}
    return all(entry.key in closed for entry in entries)
