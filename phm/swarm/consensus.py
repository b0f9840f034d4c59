"""Consensus of the swarm from the views of all agents: lost, partly reachable, split, or without a ground station. Pure.

Each agent computes it from the same views, without a leader and without rounds: views are small and sent often, and old ones do
not count. Observers are this agent and each agent that it receives, whose view is new enough and has an agent: the fault of one
that receives none is its own. An agent is *lost* when more observers have lost it than receive it, and *partly reachable* if some
do not receive it; both lists are reported. An agent that this one receives is not lost, whatever the others vote. In a split
network each side sees the other as lost; when several agents are lost together, it is reported as a split.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from phm.swarm.peers import LOST_PERIODS, Peer, Peers
from phm.wire.tunnel import PeerState, PeerView

THERE = frozenset((PeerState.ALIVE, PeerState.LATE))
SPLIT_S = 15.0
"""Agents that were lost within this time of each other count as lost together."""


class MemberState(str, Enum):
    """The state of one agent by consensus."""

    ALIVE = "alive"
    PARTLY = "partly reachable"
    LATE = "late"
    LOST = "lost"
    NEVER = "never seen"
    LEFT = "left"
    """It announced that it was stopped on purpose."""


@dataclass(frozen=True, slots=True)
class MemberStatus:
    """Consensus about one agent. `received_by`, `not_received_by`: observers; where all agree, `received_by` is all of them and may
    include the agent itself. `gcs`: whether it receives a ground station, None if unknown.
    """

    state: MemberState
    received_by: tuple[int, ...] = ()
    not_received_by: tuple[int, ...] = ()
    gcs: bool | None = None
    word: int = 0


@dataclass(frozen=True, slots=True)
class Consensus:
    """At one moment, as this agent computes it. `observers`: agents whose views counted, this one included."""

    own: int
    statuses: Mapping[int, MemberStatus] = field(default_factory=dict)
    observers: tuple[int, ...] = ()
    split: tuple[int, ...] = ()
    """Two or more agents that were lost together; empty when no split is detected."""
    receive_none: tuple[int, ...] = ()
    """Agents that are received and receive no other one, by their views; this one too, if it receives none."""

    @property
    def members(self) -> int:
        """Number of members, this agent included, without those that left on purpose."""
        return 1 + sum(status.state is not MemberState.LEFT for status in self.statuses.values())

    @property
    def living(self) -> tuple[int, ...]:
        """Ids of the agents that are alive, this one included, ascending."""
        there = (MemberState.ALIVE, MemberState.PARTLY, MemberState.LATE)
        return tuple(sorted((self.own, *(a for a, v in self.statuses.items() if v.state in there))))

    @property
    def lost(self) -> tuple[int, ...]:
        """Ids of the agents that the swarm counts as lost."""
        return tuple(agent for agent, status in self.statuses.items() if status.state is MemberState.LOST)


def compute_consensus(peers: Peers, now: float) -> Consensus:
    """The state of the swarm."""
    seen = peers.states(now)
    views = {
        agent: view for agent, peer in peers.all().items() if seen[agent] in THERE and (view := peer.fresh_view(now))
    }
    received = frozenset(agent for agent, how in seen.items() if how in THERE)
    receive_none = _receive_none(
        peers.own, received, views, known=sum(not peer.leaving for peer in peers.all().values())
    )
    gcs = {agent: view.gcs for agent, view in views.items()}
    for agent in views.keys() & set(receive_none):
        del views[agent]
    observers = tuple(sorted((peers.own, *views)))
    # Usually all observers receive the same agents: those need no counting, and 100 agents do not cost 10 000 comparisons.
    disputed = {
        agent for observer, view in views.items() for agent in received.difference(view.there) if agent != observer
    }
    undisputed = received - disputed
    statuses = {
        agent: _unanimous(agent, how, observers, gcs.get(agent), peers)
        if agent in undisputed
        else _status(agent, how, views, gcs.get(agent), peers)
        for agent, how in seen.items()
    }
    # An agent that we receive is not lost: when a split ends, views of the other half still report ours as lost.
    lost = [
        agent for agent, status in statuses.items() if status.state is MemberState.LOST and seen[agent] not in THERE
    ]
    return Consensus(peers.own, statuses, observers, _together(lost, peers), receive_none)


def without_gcs(consensus: Consensus, own_gcs: bool) -> tuple[int, ...]:
    """Agents that are alive and do not receive the ground while another one does: their radio failed, not the ground."""
    some_do = own_gcs or any(status.gcs for status in consensus.statuses.values())
    if not some_do:
        return ()
    no_gcs = [agent for agent in consensus.living if agent != consensus.own and consensus.statuses[agent].gcs is False]
    return tuple(sorted([*no_gcs, *([] if own_gcs else [consensus.own])]))


def _receive_none(own: int, received: frozenset[int], views: Mapping[int, PeerView], known: int) -> tuple[int, ...]:
    """See `Consensus.receive_none`. Of two agents each may be the cause: then neither is."""
    if known < 2:
        return ()
    receive_none = [agent for agent, view in views.items() if not view.there]
    return tuple(sorted([*receive_none, *([] if received else [own])]))


def _unanimous(agent: int, how: PeerState, observers: tuple[int, ...], gcs: bool | None, peers: Peers) -> MemberStatus:
    peer = peers.peer(agent)
    assert peer is not None
    state = MemberState.LATE if how is PeerState.LATE else MemberState.ALIVE
    return MemberStatus(state, observers, (), gcs, peer.word)


def _status(agent: int, how: PeerState, views: Mapping[int, PeerView], gcs: bool | None, peers: Peers) -> MemberStatus:
    peer = peers.peer(agent)
    assert peer is not None
    received, not_receiving = ([peers.own], []) if how in THERE else ([], [peers.own])
    never: list[int] = []
    """No votes while another agent receives it: these may have been started a moment ago."""
    for observer, view in views.items():
        if observer == agent:
            continue
        if agent in view.there:
            received.append(observer)
        elif view.peers.get(agent, PeerState.NEVER) is PeerState.NEVER:
            never.append(observer)
        else:
            not_receiving.append(observer)
    if not received:
        not_receiving += never
    words = (tuple(sorted(received)), tuple(sorted(not_receiving)), gcs, peer.word)
    if peer.leaving and how is PeerState.LOST and not _is_back(peer, received, peers):
        return MemberStatus(MemberState.LEFT, *words)
    if not received:
        ever = how is not PeerState.NEVER or any(
            view.peers.get(agent, PeerState.NEVER) is not PeerState.NEVER for view in views.values()
        )
        return MemberStatus(MemberState.LOST if ever else MemberState.NEVER, *words)
    if len(not_receiving) > len(received) and how is not PeerState.ALIVE:
        return MemberStatus(MemberState.LOST, *words)
    if not_receiving:
        return MemberStatus(MemberState.PARTLY, *words)
    return MemberStatus(MemberState.LATE if how is PeerState.LATE else MemberState.ALIVE, *words)


def _is_back(peer: Peer, observers: list[int], peers: Peers) -> bool:
    """Whether one of those that receive it does so since its shutdown: without its POWEROFF, they have lost it only after
    LOST_PERIODS."""
    assert peer.received_s is not None
    ended_s = peer.received_s + (LOST_PERIODS + 1.0) * peer.period_s
    found = [peers.peer(agent) for agent in observers]
    return any(one is not None and one.view_s is not None and one.view_s > ended_s for one in found)


def _together(lost: list[int], peers: Peers) -> tuple[int, ...]:
    """The largest group of two or more lost agents that became silent within SPLIT_S of each other; else empty."""
    times = sorted(
        (peer.received_s, agent) for agent in lost if (peer := peers.peer(agent)) and peer.received_s is not None
    )
    best: list[int] = []
    for start, (began, _) in enumerate(times):
        group = [agent for received, agent in times[start:] if received - began <= SPLIT_S]
        best = max(best, group, key=len)
    return tuple(sorted(best)) if len(best) > 1 else ()
