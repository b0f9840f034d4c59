"""The application container loses its network."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Disconnects the application from its first network through the engine."""

    name, title, unit = "network_disconnected", "network disconnected", "network/ros_app"

    def inject(self, agent: Agent) -> float:
        app = agent.app
        network = next(iter(app.attrs["NetworkSettings"]["Networks"]))
        moment = time.monotonic()
        agent.docker.networks.get(network).disconnect(app, force=True)
        return moment
