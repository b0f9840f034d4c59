"""Facts from the swarm probe about the other agents. Part of `phm.facts`; import them from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class PeerFact:
    """Another agent, by consensus of the swarm.

    state:               alive, late, partly reachable, lost, never seen, or left (stopped intentionally).
    age_s:               since this agent last received from it; None if it never did.
    received_by,
    not_received_by:     ids of the agents that do, or do not, receive it and whose views counted, this one included.
    gcs:                 whether it reports that it receives a ground station; None if it has not reported this recently.
    word:                its newest status word.
    since_s:             how long it has been in this state.
    restarts:            how often its PHM was started, or reloaded its configuration, since it was first received.
    """

    state: str
    age_s: float | None
    received_by: tuple[int, ...] = ()
    not_received_by: tuple[int, ...] = ()
    gcs: bool | None = None
    word: int = 0
    since_s: float = float("inf")
    restarts: int = 0


@dataclass(frozen=True, slots=True)
class SwarmFact:
    """State of the swarm, as this agent computes it from all views including its own.

    peers:           by agent id, without this agent.
    members, living: numbers of agents, this one included.
    split:           agents that were lost together.
    no_gcs:          living agents that receive no ground station while others do.
    duplicate_ids:   ids that two agents use.
    leader:          id of the agent that reports for the swarm; None while no agent receives the ground and another agent.
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
    """How long this agent has been listening. Shortly after the start, absence proves nothing."""
    links: tuple[str, ...] = ()
    """Names of the links on which another agent was received recently; if there are none, on which one was ever received."""
    unlisted: tuple[int, ...] = ()
    """Ids received recently that are not in `swarm.agents`, if that is set. They are ignored."""
    receive_none: tuple[int, ...] = ()
    """Agents that are received and receive no other agent; this one too, if it receives none though two or more are known."""
    heartbeat_s: float = 2.0
    """Seconds between the heartbeats of an agent in a swarm of this size."""


class SwarmProbe(Protocol):
    """Reads what this agent and its peers know about the swarm."""

    def snapshot(self) -> SwarmFact:
        """Never fails: unknown values are marked as unknown."""
