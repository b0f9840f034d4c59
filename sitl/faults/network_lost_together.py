"""PHM and the application lose the network in the same moment."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

from docker import DockerClient

from sitl.faults._networks import both_connected, connect_both, first_network
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Disconnects both from the application's first network through the engine, by two clients together. To PHM the loss of its own
    connection must not hide that of the application, nor become a separate alarm."""

    name, title, unit = "network_lost_together", "PHM and application lose the network", "network/ros_app"
    condition = "disconnected"
    layer = "container"
    cause = "a script or an operator disconnected everything from the network"
    evidence, evidence_s = "the engine's events of the disconnections", 0.1

    _network = ""

    def inject(self, agent: Agent) -> float:
        self._network = first_network(agent)
        containers = [str(agent.app.id), str(agent.sidecar.id)]
        with ThreadPoolExecutor(len(containers)) as pool:
            moment = time.monotonic()
            for done in [pool.submit(_disconnect, self._network, container) for container in containers]:
                done.result()
        return moment

    def clear(self, agent: Agent) -> None:
        if self._network:
            connect_both(agent, self._network)

    def restored(self, agent: Agent) -> bool | None:
        return both_connected(agent, self._network) if self._network else None


def _disconnect(network: str, container: str) -> None:
    """With a separate client, since one belongs to one thread."""
    client = DockerClient.from_env()
    try:
        client.networks.get(network).disconnect(container, force=True)
    finally:
        client.close()
