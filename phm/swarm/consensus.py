"""What the swarm agrees on, from everybody's views: lost or only partly reachable, split, or without its ground. Pure.

Each agent computes it for itself from the same views, with no leader and no rounds: views are small, sent often, and
old ones do not count. An observer is an agent that this one hears and whose view is young, and this one itself.
An agent is *lost* when more observers have lost it than hear it, and *partly reachable* otherwise; who hears it and who
does not is reported in both cases. No vote of others makes an agent lost that this one hears itself. In a split network each
side sees the other as lost, which is what either can know; it says so as a split when several vanish together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from phm.swarm.peers import Peers
from phm.wire.tunnel import PeerState, PeerView

THERE = frozenset((PeerState.ALIVE, PeerState.LATE))
SPLIT_S = 15.0
"""Agents that were lost within this time of each other vanished together."""


class MemberState(str, Enum):
    """What the swarm agrees on about one agent."""

    ALIVE = "alive"
    PARTLY = "partly reachable"
    LATE = "late"
    LOST = "lost"
    NEVER = "never seen"
    LEFT = "left"
    """It said that it was stopped on purpose."""


@dataclass(frozen=True, slots=True)
class MemberStatus:
    """About one agent. `heard_by`, `not_heard_by`: observers; where all agree, `heard_by` is all of them and may name the agent
    itself. `gcs`: whether it hears a ground station, None unknown.
    """

    state: MemberState
    heard_by: tuple[int, ...] = ()
    not_heard_by: tuple[int, ...] = ()
    gcs: bool | None = None
    word: int = 0


@dataclass(frozen=True, slots=True)
class Consensus:
    """As of one moment, as this agent computes it. `observers`: whose views counted, this one included."""

    own: int
    statuses: Mapping[int, MemberStatus] = field(default_factory=dict)
    observers: tuple[int, ...] = ()
    split: tuple[int, ...] = ()
    """Agents that vanished together, two or more; empty when the network is whole as far as one can tell."""

    @property
    def members(self) -> int:
        """This agent and all others that belong to the swarm; who left on purpose does not count."""
        return 1 + sum(status.state is not MemberState.LEFT for status in self.statuses.values())

    @property
    def living(self) -> tuple[int, ...]:
        """Ids of those that live, this one included, ascending."""
        there = (MemberState.ALIVE, MemberState.PARTLY, MemberState.LATE)
        return tuple(sorted((self.own, *(a for a, v in self.statuses.items() if v.state in there))))

    @property
    def lost(self) -> tuple[int, ...]:
        return tuple(agent for agent, status in self.statuses.items() if status.state is MemberState.LOST)


def compute_consensus(peers: Peers, now: float, own_gcs: bool) -> Consensus:
    """The swarm's state. own_gcs: whether this agent hears a ground station itself."""
    seen = peers.states(now)
    views: dict[int, PeerView] = {agent: view for agent, peer in peers.all().items() if (view := peer.votes(now))}
    observers = tuple(sorted((peers.own, *views)))
    # Mostly all observers hear the same agents: those need no counting, and a hundred agents cost no ten thousand looks.
    undisputed = frozenset(agent for agent, how in seen.items() if how in THERE).intersection(
        *(view.there | {observer} for observer, view in views.items())
    )
    statuses = {
        agent: _unanimous(agent, how, observers, views, peers)
        if agent in undisputed
        else _status(agent, how, views, peers, now)
        for agent, how in seen.items()
    }
    # Those that we hear did not vanish: when a split heals, the other half's views still say that ours is lost.
    lost = [
        agent for agent, status in statuses.items() if status.state is MemberState.LOST and seen[agent] not in THERE
    ]
    return Consensus(peers.own, statuses, observers, _together(lost, peers))


def without_gcs(consensus: Consensus, own_gcs: bool) -> tuple[int, ...]:
    """Living agents that do not hear the ground while another one does: their radio has failed, not the ground."""
    some_do = own_gcs or any(status.gcs for status in consensus.statuses.values())
    if not some_do:
        return ()
    no_gcs = [agent for agent in consensus.living if agent != consensus.own and consensus.statuses[agent].gcs is False]
    return tuple(sorted([*no_gcs, *([] if own_gcs else [consensus.own])]))


def _unanimous(
    agent: int, how: PeerState, observers: tuple[int, ...], views: Mapping[int, PeerView], peers: Peers
) -> MemberStatus:
    peer, view = peers.peer(agent), views.get(agent)
    assert peer is not None
    state = MemberState.LATE if how is PeerState.LATE else MemberState.ALIVE
    return MemberStatus(state, observers, (), view.gcs if view is not None else None, peer.word)


def _status(agent: int, how: PeerState, views: Mapping[int, PeerView], peers: Peers, now: float) -> MemberStatus:
    peer = peers.peer(agent)
    assert peer is not None
    heard, not_hearing = ([peers.own], []) if how in THERE else ([], [peers.own])
    for observer, view in views.items():
        if observer == agent:
            continue
        (heard if agent in view.there else not_hearing).append(observer)
    own_word = views.get(agent)
    words = (tuple(sorted(heard)), tuple(sorted(not_hearing)), own_word.gcs if own_word else None, peer.word)
    if peer.leaving and how is PeerState.LOST:
        return MemberStatus(MemberState.LEFT, *words)
    if not heard:
        ever = how is not PeerState.NEVER or any(
            view.peers.get(agent, PeerState.NEVER) is not PeerState.NEVER for view in views.values()
        )
        return MemberStatus(MemberState.LOST if ever else MemberState.NEVER, *words)
    if len(not_hearing) > len(heard) and how is not PeerState.ALIVE:
        return MemberStatus(MemberState.LOST, *words)
    if not_hearing:
        return MemberStatus(MemberState.PARTLY, *words)
    return MemberStatus(MemberState.LATE if how is PeerState.LATE else MemberState.ALIVE, *words)


def _together(lost: list[int], peers: Peers) -> tuple[int, ...]:
    """The largest group of lost agents that fell silent within SPLIT_S of each other, when it is two or more."""
    times = sorted((peer.heard_s, agent) for agent in lost if (peer := peers.peer(agent)) and peer.heard_s is not None)
    best: list[int] = []
    for start, (began, _) in enumerate(times):
        group = [agent for heard, agent in times[start:] if heard - began <= SPLIT_S]
        best = max(best, group, key=len)
    return tuple(sorted(best)) if len(best) > 1 else ()
