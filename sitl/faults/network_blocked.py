"""A firewall swallows all that the application sends and gets."""

from __future__ import annotations

import time

from sitl.faults._firewall import clear, drop
from sitl.faults._world import answers, app_runs
from sitl.faults.base import STOP_S, Agent, Fault


class Injection(Fault):
    """Drops every packet in the application's network namespace but those on loopback. A new interface does not help, since the
    rules are the namespace's; a new namespace does."""

    name, title, unit = "network_blocked", "network blocked by a firewall", "network/ros_app"
    condition = "address_silent"
    layer = "container"
    cause = "a firewall or a policy of the network swallows all that the application sends and gets"
    evidence, evidence_s = "the first message of a topic of 5 Hz that does not arrive", 0.2
    evidence_period_s = 0.2

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        moment = time.monotonic()
        drop(agent, "OUTPUT ! -o lo", "INPUT ! -i lo")
        return moment

    def clear(self, agent: Agent) -> None:
        clear(agent)
        if agent.generation == self._generation:
            # Nodes that were cut off for longer than their lease do not find each other again.
            agent.app.restart(timeout=STOP_S)

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent) and answers(agent.app)
