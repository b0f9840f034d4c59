"""A start of the application goes wrong: one of its nodes is not started."""

from __future__ import annotations

import time
from functools import partial

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault, put, undoing
from sitl.faults.container_created import copied, swap

LEFT_OUT = "/tmp/left_out"
"""Names of nodes that the application's launcher leaves out at its next start, and at that one alone."""


class Injection(Fault):
    """Puts a running copy in the place of the application's container, as `docker compose up` does after an update; it has come
    up without node_1. The old one goes once the copy has its name, so that there is nothing to see but the node."""

    name, title, unit = "node_never_started", "node never started", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "the application came up without one of its nodes, which lost a race at the start"
    evidence, evidence_s = "the process list after the start lacks it while the others are there", 1.0

    _generation = ""

    def inject(self, agent: Agent) -> float:
        old = agent.app
        copy = copied(agent, old)
        with undoing(partial(copy.remove, force=True)):  # else its nodes would run beside those of the old one
            put(copy, LEFT_OUT, b"node_1\n")
            moment = time.monotonic()
            copy.start()
            swap(agent, old, copy)
        old.remove(force=True)
        self._generation = agent.generation
        return moment

    def clear(self, agent: Agent) -> None:
        agent.renew_app(self._generation)

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
