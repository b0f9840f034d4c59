"""Detects that several peers became silent together, which is known sooner than the loss of a single peer: random loss would
have to affect all of them. Pure.

One missed heartbeat means little on a lossy radio; one of each of seven peers means much. So the missed heartbeats of all peers
that became silent together are added up, each by how improbable its loss is (`HeartbeatStats.weight`), less what the choice of these peers among
all explains. And since a short fade of this agent's own radio, or of the air between two groups, takes one heartbeat of each, too,
the silence has to be longer than any fade of one period, and half as long again as those that were seen lately.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from phm.swarm.heartbeat_stats import HeartbeatStats

SURE = math.log(1e5)
NEARLY = SURE / 2
FEWEST = 2


@dataclass(frozen=True, slots=True)
class SilentPeer:
    """One peer that is not lost yet. `missed`: how many of its heartbeats are overdue."""

    agent: int
    received_s: float
    stats: HeartbeatStats
    missed: int

    @property
    def due_s(self) -> float:
        """When the first missed heartbeat was due, in monotonic seconds."""
        return self.received_s + self.stats.period_s


@dataclass(frozen=True, slots=True)
class SilentGroup:
    """Peers whose silence began within one period. `weight`: of its evidence; SURE is enough."""

    members: tuple[SilentPeer, ...]
    weight: float

    @property
    def agents(self) -> frozenset[int]:
        return frozenset(member.agent for member in self.members)

    @property
    def since_s(self) -> float:
        """When the last heartbeat of any of them was received."""
        return max(member.received_s for member in self.members)

    @property
    def due_s(self) -> float:
        """When the first of their missed heartbeats was due."""
        return min(member.due_s for member in self.members)

    @property
    def outlasts_a_fade(self) -> bool:
        """Heartbeats that were due more than one period apart were missed."""
        last = max(member.received_s + member.missed * member.stats.period_s for member in self.members)
        return last - self.due_s >= max(
            (1.0 + member.stats.jitter / 2) * member.stats.period_s for member in self.members
        )

    def complete(self, peers: Iterable[SilentPeer]) -> bool:
        """Whether every other peer was received since, or was silent before: no other heartbeat is still to come."""
        return all(
            other.received_s > self.due_s or other.missed > 0 for other in peers if other.agent not in self.agents
        )


def silent_peer(agent: int, received_s: float, stats: HeartbeatStats, now: float) -> SilentPeer:
    """A peer that is not lost, by the time of its last heartbeat and its statistics."""
    return SilentPeer(agent, received_s, stats, stats.missed(now - received_s))


def most_significant_group(peers: Sequence[SilentPeer]) -> SilentGroup | None:
    """The group of two or more whose silence is the least probable by chance."""
    overdue = [entry for entry in peers if entry.missed]
    if len(overdue) < FEWEST:
        return None
    groups = []
    for last in overdue:
        members = tuple(
            entry
            for entry in overdue
            if last.received_s - entry.stats.period_s - entry.stats.slack_s < entry.received_s <= last.received_s
        )
        if len(members) >= FEWEST:
            evidence = sum(entry.stats.weight(entry.missed) for entry in members)
            groups.append(SilentGroup(members, evidence - math.log(math.comb(len(peers), len(members)))))
    return max(groups, key=lambda group: group.weight, default=None)


def lost_together(peers: Sequence[SilentPeer], now: float, least_s: float = 0.0) -> frozenset[int]:
    """Agents that are lost together; empty when none are, or it is too early to say. least_s: of their silence."""
    group = most_significant_group(peers)
    if group is None or group.weight < SURE or now - group.since_s < least_s:
        return frozenset()
    if not (group.outlasts_a_fade and group.complete(peers)):
        return frozenset()
    # A peer that had lost a heartbeat by chance just before is not in the group, but is as silent.
    return group.agents | {entry.agent for entry in peers if entry.missed > 1}
