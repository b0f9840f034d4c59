"""The MAVLink router on board is killed."""

from __future__ import annotations

from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """`docker kill` of the container in which it runs. Connections to it are refused until it is started."""

    name, title, unit = "router_killed", "MAVLink router killed", "container/router"
    condition = "exited"
    layer = "link"
    cause = "the MAVLink router on board crashed or was stopped"
    needs = frozenset({"air"})

    def inject(self, agent: Agent) -> float:
        router = agent.router
        before = router.attrs["State"]["FinishedAt"]
        router.kill()
        return died(router, before)

    def clear(self, agent: Agent) -> None:
        agent.router.start()
