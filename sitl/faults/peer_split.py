"""The network between the agents falls apart."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Half of the swarm, this agent among it, no longer receives the other half: one fault on either side."""

    name, title, unit = "peer_split", "network between agents split", "peers/swarm"
    condition = "swarm_split"
    layer = "link"
    cause = "the swarm has flown apart, or what relayed between its halves is gone"
    others = "peers/swarm"
    healable = False
    needs = frozenset({"air", "peers"})
    least = 4
    evidence, evidence_s = "the first heartbeats of the peers, every 2 s in a swarm of eight, that do not arrive", 2.0
    evidence_period_s = 2.0

    def inject(self, agent: Agent) -> float:
        agents = sorted(int(number) for number in agent.links.state()["agents"])
        agents.remove(agent.number)
        here = [agent.number, *agents[: (len(agents) + 1) // 2 - 1]]
        moment = time.monotonic()
        agent.links.split([here, [number for number in agents if number not in here]])
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.split([])

    def restored(self, agent: Agent) -> bool | None:
        return not agent.links.state()["groups"]
