"""Two things that have nothing to do with each other break in the same moment."""

from __future__ import annotations

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CRITICAL, critical_file_is_intact, put_back


class Injection(Fault):
    """Removes the critical file and kills node_1: two causes, two alarms, each recovered by its own action."""

    name, title = "two_at_once", "node killed and file deleted"
    unit, also = "nodes/{agent}/node_1", ("files/ros_app",)
    condition = "node_missing"
    layer = "container"
    cause = "two things that have nothing to do with each other break in the same moment"
    evidence, evidence_s = "the kernel's events of a change in the folder and of the end of a process", 0.1

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        agent.run_in_app("rm", CRITICAL)
        return agent.signal_node("node_1", "KILL")

    def clear(self, agent: Agent) -> None:
        put_back(agent)
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return critical_file_is_intact(agent) and app_runs(agent)
