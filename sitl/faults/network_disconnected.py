"""The application container loses its network."""

from __future__ import annotations

import time

from sitl.faults._world import answers, app_runs, attached
from sitl.faults.base import STOP_S, Agent, Fault


class Injection(Fault):
    """Disconnects the application from its first network through the engine."""

    name, title, unit = "network_disconnected", "network disconnected", "network/ros_app"
    condition = "disconnected"
    layer = "container"
    cause = "the container was taken off its network"
    evidence, evidence_s = "the engine's event of the disconnection", 0.1

    _network = ""

    def inject(self, agent: Agent) -> float:
        app = agent.app
        self._network = next(iter(app.attrs["NetworkSettings"]["Networks"]))
        moment = time.monotonic()
        agent.docker.networks.get(self._network).disconnect(app, force=True)
        return moment

    def clear(self, agent: Agent) -> None:
        app = agent.app
        if self._network and self._network not in app.attrs["NetworkSettings"]["Networks"]:
            agent.docker.networks.get(self._network).connect(app, aliases=["ros_app"])
            # Nodes that were cut off for longer than their lease do not find each other again (seen: not in 90 s).
            app.restart(timeout=STOP_S)

    def restored(self, agent: Agent) -> bool | None:
        if not self._network:
            return None
        return app_runs(agent) and attached(agent, agent.app, self._network) and answers(agent.app)
