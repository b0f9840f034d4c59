"""What the swarm probe says about the other agents. Part of `phm.facts`, and imported from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class PeerFact:
    """One other agent, as the swarm agrees on it.

    state: alive, late, partly reachable, lost, never seen, or left (stopped on purpose). age_s: since this agent heard it,
    None when it never did. heard_by, not_heard_by: ids of the agents whose view counted, this one included. gcs: whether
    it hears a ground station by its own word; None when it has not said so lately. word: its newest status word.
    since_s: for how long its state has been this one.
    """

    state: str
    age_s: float | None
    heard_by: tuple[int, ...] = ()
    not_heard_by: tuple[int, ...] = ()
    gcs: bool | None = None
    word: int = 0
    since_s: float = float("inf")


@dataclass(frozen=True, slots=True)
class SwarmFact:
    """The swarm as this agent computes it from all views, its own included.

    peers: by agent id, without this agent. members, living: how many, with it. split: agents that vanished together.
    no_gcs: living agents that hear no ground station while others do. duplicate_ids: ids that two agents use. leader: who
    leads for the swarm; None while no agent receives the ground.
    """

    own: int
    members: int
    living: int
    peers: Mapping[int, PeerFact] = field(default_factory=dict)
    split: tuple[int, ...] = ()
    no_gcs: tuple[int, ...] = ()
    duplicate_ids: tuple[int, ...] = ()
    leader: int | None = None
    gcs: bool = False
    up_s: float = 0.0
    """How long this agent has listened: absence proves nothing before."""
    links: tuple[str, ...] = ()
    """Names of the links on which another agent was heard lately."""
    unlisted: tuple[int, ...] = ()
    """Ids heard lately that are not among `swarm.agents`, where that is set: they count for nothing."""


class SwarmProbe(Protocol):
    def look(self) -> SwarmFact:
        """Never fails: what is not known is said as such."""
