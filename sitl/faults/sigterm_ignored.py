"""A node dies in a container that ignores SIGTERM: each restart takes the entire stop timeout and ends with SIGKILL."""

from __future__ import annotations

from sitl.application.app import IGNORE_TERM
from sitl.faults._application import works
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Has the application's first process ignore SIGTERM from now on, then kills node_1. A restart ends both."""

    name, title, unit = "sigterm_ignored", "node killed, its container ignores SIGTERM", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "the container's first process is a shell or launcher that does not pass on SIGTERM"
    evidence, evidence_s = "the launcher's child has ended (SIGCHLD)", 0.0

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        agent.app.kill(signal=str(IGNORE_TERM))
        return agent.signal_node("node_1", "KILL")

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
