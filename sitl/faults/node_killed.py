"""A ROS node dies without a word (SIGKILL), its container lives on."""

from __future__ import annotations

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Kills node_1 by its process id inside the application container."""

    name, title, unit = "node_killed", "node killed (SIGKILL)", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "a node crashed, its container lives on"
    evidence, evidence_s = "the launcher's child has ended (SIGCHLD)", 0.1

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        return agent.signal_node("node_1", "KILL")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
