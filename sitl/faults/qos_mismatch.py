"""A node offers its topic in a way that its subscriber does not take."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault

CARELESS = "35"
"""SIGRTMIN+1, by which a node of the demo application offers its topics as best effort."""


class Injection(Fault):
    """Has node_1 recreate its publisher as best effort; node_2 asks for reliable, and DDS keeps the two apart. A restart brings
    back what the start has."""

    name, title, unit = "qos_mismatch", "quality of service does not fit", "topics/{agent}/topic_1"
    condition = "qos_mismatch"
    layer = "ros"
    cause = "a node was updated and offers less than its subscriber asks for"
    evidence, evidence_s = "the new offer is in the ROS graph", 0.3

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", CARELESS)

    def clear(self, agent: Agent) -> None:
        if agent.generation == self._generation:
            agent.signal_node("node_1", CARELESS)
            self._generation = ""

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
