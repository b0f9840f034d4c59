"""A node is OK, but its topic has half its rate."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Has node_1 skip every second message."""

    name, title, unit = "topic_slow", "topic at half its rate", "rates/{agent}/topic_1"
    condition = "rate_low"
    layer = "ros"
    cause = "a node does not keep up: every second message is missing"
    evidence, evidence_s = "every second message is missing, at 5 Hz", 0.4
    evidence_period_s = 0.4

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", "USR2")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
