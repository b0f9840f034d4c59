"""A ROS node hangs (SIGSTOP): its process is there and does nothing."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Stops node_1. Its topic falls silent, and with the short leases of config/fastdds.xml it leaves the graph, too."""

    name, title, unit = "node_stopped", "node hung (SIGSTOP)", "nodes/{agent}/node_1"
    condition = "node_hung"
    layer = "ros"
    cause = "a node hangs: its process is there and does nothing"
    evidence, evidence_s = "the next heartbeat of its beacon is missing", 0.2
    evidence_period_s = 0.2

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", "STOP")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
