"""PHM's own container loses the application's network."""

from __future__ import annotations

import time

from sitl.faults._world import attached
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Disconnects PHM from the application's first network through the engine; the application stays on it."""

    name, title, unit = "sidecar_disconnected", "PHM off the application's network", "network/ros_app"
    condition = "sidecar_disconnected"
    layer = "container"
    cause = "PHM's own container was taken off the application's network"
    evidence, evidence_s = "the engine's event of the disconnection", 0.1

    def inject(self, agent: Agent) -> float:
        phm, network = agent.container("phm"), self._network(agent)
        moment = time.monotonic()
        agent.docker.networks.get(network).disconnect(phm, force=True)
        return moment

    def clear(self, agent: Agent) -> None:
        phm, network = agent.container("phm"), self._network(agent)
        if network not in phm.attrs["NetworkSettings"]["Networks"]:
            agent.docker.networks.get(network).connect(phm)

    def restored(self, agent: Agent) -> bool | None:
        return attached(agent, agent.sidecar, self._network(agent))

    @staticmethod
    def _network(agent: Agent) -> str:
        return str(next(iter(agent.app.attrs["NetworkSettings"]["Networks"])))
