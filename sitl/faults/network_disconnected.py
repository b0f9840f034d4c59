"""The application container loses its network."""

from __future__ import annotations

import time

from sitl.faults._networks import restart_if_lost
from sitl.faults._world import answers, app_runs, attached, found_by_others
from sitl.faults.base import Agent, Fault


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
        restart_if_lost(agent)

    def restored(self, agent: Agent) -> bool | None:
        if not self._network:
            return None
        app = agent.app
        # The quick looks first: PHM may have connected it again a tenth of a second later.
        return attached(agent, app, self._network) and found_by_others(app) and app_runs(agent) and answers(app)
