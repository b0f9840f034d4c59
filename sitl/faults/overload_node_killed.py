"""A node dies while the machine is overloaded."""

from __future__ import annotations

import time

from sitl.faults._application import works
from sitl.faults._overload import end_overload, overload
from sitl.faults.base import Agent, Fault, undoing

BEFORE_S = 10.0


class Injection(Fault):
    """Kills node_1 after 10 s of an overload that goes on for 50 s: the load explains neither its death nor the restart that recovers it."""

    name, title, unit = "overload_node_killed", "node killed (SIGKILL) during an overload", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "a node crashed while other containers take all cores"
    evidence, evidence_s = "the launcher's child has ended (SIGCHLD)", 0.1
    also = ("host/cpu",)
    needs = frozenset({"alone", "starvation"})

    _generation = ""

    def inject(self, agent: Agent) -> float:
        with undoing(lambda: end_overload(agent)):
            overload(agent)
            time.sleep(BEFORE_S)
            self._generation = agent.generation
            return agent.signal_node("node_1", "KILL")

    def clear(self, agent: Agent) -> None:
        end_overload(agent)
        if self._generation:
            agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
