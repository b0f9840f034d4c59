"""The status of the swarm in one line and in one TUNNEL, which the leader sends to the ground. Pure.

The line, at most 50 characters: how many of how many agents are OK, the worst level, and the others, worst first::

    SWARM 8/8 OK
    SWARM 7/8 FAIL A03:ROS
    SWARM 5/8 FAIL A06:lost A07:lost A03:ROS
    SWARM 90/100 FAIL A07:lost A12:DOCKER A13:ROS +7
    SWARM 7/8 WARN A02:no-GCS                    alive, but receives no ground station
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache

from phm.core.model import Level, Slot
from phm.swarm.consensus import Consensus, MemberState
from phm.wire import status_word
from phm.wire.status_line import MAX_CHARS, Severity, agent_name, severity
from phm.wire.tunnel import SwarmDigest

_LAYERS: Mapping[Slot, str] = {
    Slot.COMPANION: "LINK",
    Slot.CONTAINER: "DOCKER",
    Slot.FILES: "FILES",
    Slot.NETWORK: "NET",
    Slot.DEVICES: "DEVICE",
    Slot.NODES: "ROS",
    Slot.TOPICS: "ROS",
    Slot.RATES: "ROS",
    Slot.HOST: "HOST",
    Slot.AUTOPILOT: "PILOT",
    Slot.RADIO: "RADIO",
    Slot.PEERS: "PEERS",
}
_WORD = {Level.OK: "OK", Level.STALE: "OK", Level.WARN: "WARN", Level.ERROR: "FAIL"}


@lru_cache(maxsize=256)  # words change seldom, and the leader asks about each agent every moment
def worst_slot(word: int, *, no_gcs: bool = False) -> tuple[Level, Slot | None]:
    """The worst level in a status word and the first slot that has it; STALE, None for an empty word.

    no_gcs: an agent that receives no ground station reports that in slot 1 or 11, and does not know the complete path of a
    command (10): neither may hide its other failures.
    """
    try:
        member_levels = status_word.decode(word)
    except ValueError:
        return Level.STALE, None
    # Slot 12 reports lost peers: the digest reports those once, from the consensus.
    member_levels.pop(Slot.PEERS, None)
    if not member_levels:
        return Level.STALE, None
    if no_gcs:
        member_levels = {slot: level for slot, level in member_levels.items() if not _is_path(slot, level)} or {
            Slot.COMPANION: Level.OK
        }
    slot = max(member_levels, key=lambda entry: (member_levels[entry].severity, -entry))
    return member_levels[slot], slot


def member_levels(consensus: Consensus, own_word: int, no_gcs: Collection[int] = ()) -> dict[int, tuple[Level, str]]:
    """Level and cause of each member, by agent id."""
    levels = {consensus.own: _of_word(own_word, no_gcs=consensus.own in no_gcs)}
    for agent, status in consensus.statuses.items():
        if status.state is MemberState.LEFT:
            continue
        if status.state is MemberState.LOST:
            levels[agent] = (Level.ERROR, "lost")
        elif status.state is MemberState.NEVER:
            levels[agent] = (Level.STALE, "unseen")
        else:
            levels[agent] = _of_word(status.word, no_gcs=agent in no_gcs)
    for agent in no_gcs:
        if levels[agent][0] in (Level.OK, Level.STALE):
            levels[agent] = (Level.WARN, "no-GCS")
    return dict(sorted(levels.items()))


def digest_line(levels: Mapping[int, tuple[Level, str]]) -> str:
    """The line of the leader about the swarm; see the module."""
    healthy = sum(level is Level.OK for level, _ in levels.values())
    bad = sorted(
        ((agent, level, why) for agent, (level, why) in levels.items() if level is not Level.OK and why),
        key=lambda entry: (-entry[1].severity, entry[2] != "lost", entry[0]),
    )
    gravest = max((level for level, _ in levels.values()), key=lambda level: level.severity, default=Level.STALE)
    text = f"SWARM {healthy}/{len(levels)} {_WORD[gravest]}"
    for number, (agent, _, why) in enumerate(bad):
        piece = f" {agent_name(agent)}:{why}"
        left = len(bad) - number - 1
        more = f" +{left}" if left else ""
        if len(text) + len(piece) + len(more) > MAX_CHARS:
            return f"{text} +{left + 1}"
        text += piece
    return text


def relay_line(agent: int, received_by: Collection[int], word: int) -> str:
    """The status of an agent that does not reach the ground, at most 50 characters, by its newest status word::

    A03 no GCS radio, received by A01 A02: 2 ERROR
    A03 no GCS radio, received by A01 A02 +5: OK
    """
    level, slot = worst_slot(word, no_gcs=True)
    how = "unknown" if level is Level.STALE else "OK" if level is Level.OK or slot is None else f"{slot:d} {level.name}"
    names = [agent_name(other) for other in sorted(received_by) if other != agent]
    for shown in range(min(len(names), 4), -1, -1):
        more = f" +{len(names) - shown}" if shown < len(names) else ""
        text = f"{agent_name(agent)} no GCS radio, received by {' '.join(names[:shown])}{more}: {how}"
        if len(text) <= MAX_CHARS:
            return text
    return text[:MAX_CHARS]


def flapping_line(agent: int) -> str:
    """An agent repeatedly loses and finds the ground, or fails and recovers meanwhile; each change is not reported."""
    return f"{agent_name(agent)} no GCS radio: flapping"


def relay_severity(word: int) -> Severity:
    """As of the agent's own line; a lost radio alone is a warning."""
    level, slot = worst_slot(word, no_gcs=True)
    return severity(level, slot) if level.bad and slot is not None else Severity.WARNING


def swarm_digest(consensus: Consensus, levels: Mapping[int, tuple[Level, str]]) -> SwarmDigest:
    return SwarmDigest(
        consensus.members, min(len(consensus.living), consensus.members), {a: lv for a, (lv, _) in levels.items()}
    )


def _is_path(slot: Slot, level: Level) -> bool:
    return slot in (Slot.COMPANION, Slot.RADIO) or (slot is Slot.AUTOPILOT and level is Level.STALE)


def _of_word(word: int, *, no_gcs: bool) -> tuple[Level, str]:
    level, slot = worst_slot(word, no_gcs=no_gcs)
    if level is Level.OK:
        return level, ""
    return level, _LAYERS.get(slot, "USER") if slot is not None else "unknown"
