"""A start of the application goes wrong: one of its nodes is not started."""

from __future__ import annotations

from sitl.faults.base import STOP_S, Agent, Fault, mono_of

LEFT_OUT = "/tmp/left_out"
"""Names of nodes that the application's launcher leaves out at its next start, and at that one alone."""


class Injection(Fault):
    """Restarts the application so that it comes up without node_1. The fault is there when the container has started."""

    name, title, unit = "node_never_started", "node never started", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "the application came up without one of its nodes, which lost a race at the start"

    _life = ""

    def inject(self, agent: Agent) -> float:
        agent.write_in_app(LEFT_OUT, b"node_1\n")
        agent.app.restart(timeout=STOP_S)
        self._life = agent.life
        return mono_of(agent.app.attrs["State"]["StartedAt"])

    def clear(self, agent: Agent) -> None:
        agent.write_in_app(LEFT_OUT, b"")
        agent.renew_app(self._life)
