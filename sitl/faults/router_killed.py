"""The MAVLink router aboard is killed."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Connections to it are refused. PHM opens its own again as soon as somebody answers; the router is not PHM's to start."""

    name, title, unit = "router_killed", "MAVLink router killed", "link/router"
    condition = "link_closed"
    layer = "link"
    cause = "the MAVLink router aboard crashed or was stopped"
    healable = False
    needs = frozenset({"air"})

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "router", off=True)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)
