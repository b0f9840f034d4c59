"""A node is OK, but it no longer listens to its topic."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Has node_2 give up its subscription to the topic of node_1."""

    name, title, unit = "subscriber_lost", "subscriber lost, its node alive", "topics/{agent}/topic_1"
    condition = "subscriber_lost"
    layer = "ros"
    cause = "a node gave up its subscription after an error, and goes on without it"
    evidence, evidence_s = "the endpoint has left the ROS graph", 0.3

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_2", "HUP")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
