"""Slot 12: the other agents are alive according to the swarm, and the network between them is intact."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._text import brief, merged, span

GRACE_S = 30.0
"""Agents are switched on one after another: a missing agent is not reported so soon after PHM's start."""
GRACE_PERIODS = 5.0
"""Of the heartbeats that PHM must have listened for, as for a lost agent. In a large swarm they are longer than GRACE_S."""
SETTLE_S = 5.0
"""Agents that disappear together are detected together (`phm.swarm.group_loss`) or within seconds of each other. A split
is reported immediately, before single agents are."""
TOGETHER_S = 15.0
"""Agents lost within this time of each other were lost together, as in a split."""
MOST = 8
"""Agents that are named."""
SWARM = "peers/swarm"
THERE = ("alive", "late", "partly reachable")


class Peers(api.Check):
    """One unit for each configured agent, and one for the entire swarm, which also reports the agents not configured."""

    name, slot, layer = "peers", Slot.PEERS, Layer.LINK
    period_s = 1.0

    def __init__(self, agents: Sequence[int]) -> None:
        self._agents = tuple(agents)
        self._away: frozenset[int] = frozenset()
        """The agents reported as disappeared together. They return one by one, which does not change the report."""
        self._units = (
            api.Unit(SWARM, grace_s=GRACE_S),
            *(api.Unit(_unit(agent), needs=(SWARM,), settle_s=SETTLE_S, grace_s=GRACE_S) for agent in self._agents),
        )

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        if not settings.mavlink.endpoints:
            return []
        return [cls([agent for agent in dict.fromkeys(settings.swarm.agents) if agent != settings.agent.id])]

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"swarm"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        fact = world.swarm.snapshot()
        results = {_unit(agent): _agent(agent, fact) for agent in self._agents}
        return {SWARM: self._swarm(fact), **results}

    def _swarm(self, fact: api.SwarmFact) -> api.Result:
        """Faults of several agents, and faults of agents that are not in the configuration."""
        settled = {agent for agent, peer in fact.peers.items() if peer.since_s >= SETTLE_S}
        found = [*_duplicate_ids(fact), *_all_peers_lost(fact), *self._split(fact)]
        if not found:
            others = sorted(settled.difference(self._agents))
            found = [result for agent in others if (result := _agent(agent, fact)).level.bad]
        values: dict[str, api.Value] = {"members": fact.members, "living": fact.living, "leader": fact.leader}
        if fact.unlisted:
            values["not_listed"] = _names(fact.unlisted)
        if found:
            result = merged(found, values)
            lost = self._subjects(agent for agent, peer in fact.peers.items() if peer.state == "lost")
            return result.with_evidence(replace(result.evidence, subjects=lost))
        if not fact.peers:
            words = "no heartbeat from another agent received, and none is configured (swarm.agents)"
            return api.bypass(words, values=values).with_evidence(api.Evidence(unobserved=True))
        received = self._subjects(agent for agent, peer in fact.peers.items() if peer.age_s is not None)
        words = f"{fact.living} of {fact.members} agents of the swarm are alive"
        return api.ok(words, values=values).with_evidence(api.Evidence(subjects=received))

    def _subjects(self, agents: Iterable[int]) -> tuple[str, ...] | None:
        """For `Evidence.subjects`: without a configuration only the agents received since PHM's start are known."""
        return None if self._agents else tuple(_name(agent) for agent in sorted(agents))

    def _split(self, fact: api.SwarmFact) -> list[api.Result]:
        lost = [agent for agent, peer in fact.peers.items() if peer.state == "lost"]
        if not fact.split or len(lost) >= len(_received(fact)):
            self._away = frozenset()
            return []
        away = [(agent, fact.peers[agent]) for agent in self._away if agent in fact.peers]
        coming = {agent for agent, peer in away if peer.state == "lost" or peer.since_s < SETTLE_S}
        self._away = frozenset(coming.union(fact.split))
        here = {fact.own, *(agent for agent, peer in fact.peers.items() if peer.state in THERE)} - self._away
        return [
            api.error(
                f"the swarm is split: {_names(self._away)} disappeared together and {_names(here)} are still reachable: either the network "
                "between the groups is broken or all agents of that group failed",
                brief=brief(f"split {len(here)}/{fact.members}", f"lost {_names(self._away, 3)}"),
                condition="swarm_split",
            ).with_evidence(api.Evidence(conclusive=len(here) > 1))
        ]


def _agent(agent: int, fact: api.SwarmFact) -> api.Result:
    peer = fact.peers.get(agent, api.PeerFact("never seen", None))
    name = _name(agent)
    values: dict[str, api.Value] = {
        "state": peer.state,
        "age_s": None if peer.age_s is None else round(peer.age_s, 1),
        "received_by": len(peer.received_by),
        "not_received_by": len(peer.not_received_by),
    }
    others = set(peer.not_received_by) - {fact.own}
    # Another agent has lost it too, so a delay on this agent is not the cause.
    known = api.Evidence(conclusive=bool(others))
    # In its first periods this agent has no vote on what it has not received yet: the others may be sufficient without it.
    without_own = len(others) > (len(peer.received_by) if peer.state == "lost" else 0)
    started = fact.up_s < GRACE_PERIODS * fact.heartbeat_s
    if started and peer.age_s is None and (peer.state == "never seen" or not without_own):
        return api.stale(f"no heartbeat from agent {name} received so far", values=values)
    disagreement = f", but still received by {_names(peer.received_by)}" if peer.received_by else ""
    silent = "" if peer.age_s is None else f", here for {span(peer.age_s)}"
    if peer.state == "lost":
        words = (
            f"agent {name} is lost: no heartbeat received by {_names(peer.not_received_by)}{silent}{disagreement}: check the "
            "vehicle, its power and its radio"
        )
        return api.Result(Level.ERROR, words, brief(name, "lost"), "peer_lost", values=values, evidence=known)
    if peer.state == "never seen":
        words = f"no heartbeat ever received from agent {name}, which is configured in swarm.agents: check that it is powered on and on this network"
        return api.Result(
            Level.WARN, words, brief(name, "never seen"), "peer_never_seen", values=values, evidence=known
        )
    if agent in fact.receive_none and peer.state in THERE:
        words = f"agent {name} is received but receives no other agent: check its radio's receiver and its network"
        short = brief(name, "receives no other agent")
        evidence = api.Evidence(recovered=True)  # it is received, so it is not lost any more
        return api.Result(Level.WARN, words, short, "peer_receives_none", values=values, evidence=evidence)
    if peer.state == "partly reachable":
        words = (
            f"agent {name} is alive, received by {_names(peer.received_by)} but not by {_names(peer.not_received_by)}: the network "
            "between these is broken or at the edge of its range"
        )
        short = brief(name, f"not seen by {_names(peer.not_received_by, 3)}")
        return api.Result(Level.WARN, words, short, "peer_partly", values=values, evidence=known)
    if peer.state == "left":
        return api.bypass(f"agent {name} was shut down intentionally", values=values)
    return api.ok(f"agent {name} is {peer.state}", values=values)


def _duplicate_ids(fact: api.SwarmFact) -> list[api.Result]:
    if not fact.duplicate_ids:
        return []
    return [
        api.error(
            f"two agents use the id of {_names(fact.duplicate_ids)}, so their reports are mixed up; give each a unique agent.id",
            brief=brief(_names(fact.duplicate_ids, 3), "id used twice"),
            condition="agent_id_duplicate",
        )
    ]


def _all_peers_lost(fact: api.SwarmFact) -> list[api.Result]:
    """One fault when all others are lost: if they were lost together, the likely cause is this agent's own radio."""
    lost = [agent for agent, peer in fact.peers.items() if peer.state == "lost" and fact.own not in peer.received_by]
    if len(lost) < 2 or len(lost) < len(_received(fact)):
        return []
    ages = sorted((age_s, agent) for agent in lost if (age_s := fact.peers[agent].age_s) is not None)
    if ages and ages[-1][0] - ages[0][0] > TOGETHER_S:
        since = ", ".join(f"{_name(agent)} for {span(age_s)}" for age_s, agent in ages[:MOST])
        words = f"no heartbeat from any other agent, {since}: check the vehicle of {_name(ages[0][1])} first, then this agent's own link"
    else:
        words = (
            f"no heartbeat from any other agent, {_names(lost)} were lost together: check this agent's own link first"
        )
    return [api.error(words, brief=brief("all peers", "lost"), condition="all_peers_lost")]


def _received(fact: api.SwarmFact) -> list[int]:
    """The agents that were received and have not left: one that was never switched on says nothing about the network."""
    return [agent for agent, peer in fact.peers.items() if peer.state not in ("left", "never seen")]


def _names(agents: Iterable[int], most: int = MOST) -> str:
    """`A01 A02`, and `+3` for those beyond `most`."""
    ids = sorted(agents)
    more = f" +{len(ids) - most}" if len(ids) > most else ""
    return " ".join(_name(agent) for agent in ids[:most]) + more


def _name(agent: int) -> str:
    return f"A{agent:02d}"


def _unit(agent: int) -> str:
    return f"peers/{_name(agent)}"
