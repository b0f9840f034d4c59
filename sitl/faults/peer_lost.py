"""An agent's radio to the other agents fails."""

from __future__ import annotations

import time

from sitl.faults._world import link
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Neither it nor the others receive anything of each other: one fault on either side."""

    name, title, unit = "peer_lost", "peer lost", "peers/swarm"
    condition = "all_peers_lost"
    layer = "link"
    cause = "an agent's radio to the others fails, or the agent is out of their range"
    healable = False
    others = "peers/{id}"
    needs = frozenset({"air", "peers"})
    least = 3
    evidence, evidence_s = "the first heartbeats of the peers, every 2 s in a swarm of eight, that do not arrive", 2.0
    evidence_period_s = 2.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "peers", cut=True)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)

    def restored(self, agent: Agent) -> bool | None:
        return not link(agent, "peers")["cut"]
