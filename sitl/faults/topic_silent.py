"""A node is OK, but its topic has fallen silent."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Has node_1 stop publishing; it stays in the graph."""

    name, title, unit = "topic_silent", "topic silent, its node alive", "rates/{agent}/topic_1"
    condition = "topic_silent"
    layer = "ros"
    cause = "a node's source has stopped, the node itself is OK"
    evidence, evidence_s = "the next message is missing, at 5 Hz", 0.2
    evidence_period_s = 0.2

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", "USR1")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
