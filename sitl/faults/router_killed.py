"""The MAVLink router on board is killed."""

from __future__ import annotations

import time

from sitl.faults._world import link, runs
from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """`docker kill` of the container in which it runs. Connections to it are refused until it is started."""

    name, title, unit = "router_killed", "MAVLink router killed", "container/router"
    condition = "exited"
    layer = "link"
    cause = "the MAVLink router on board crashed or was stopped"
    needs = frozenset({"air"})
    evidence, evidence_s = "the kernel closes PHM's connection, and the engine reports the end of the container", 0.1

    _before = 0

    def inject(self, agent: Agent) -> float:
        router = agent.router
        before = router.attrs["State"]["FinishedAt"]
        moment = time.monotonic()
        router.kill()
        died(router, before)
        self._before = self._forwarded(agent)
        return moment

    @staticmethod
    def _forwarded(agent: Agent) -> int:
        """Bytes from PHM that have reached the radio."""
        return agent.links.traffic()[agent.number].get("phm_to_ground", 0)

    def clear(self, agent: Agent) -> None:
        agent.router.start()

    def restored(self, agent: Agent) -> bool | None:
        if not runs(agent.router) or link(agent, "router")["connected"] == 0:
            return False
        return self._forwarded(agent) > self._before
