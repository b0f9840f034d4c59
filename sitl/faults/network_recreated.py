"""The application's network is removed and created again under its name."""

from __future__ import annotations

import time
from typing import Any

from docker.errors import APIError, NotFound

from sitl.faults._networks import both_connected, connect_both, first_network
from sitl.faults.base import Agent, Fault, freeze

TRIES = 5


class Injection(Fault):
    """What `docker compose down` and `up` of the project that owns the network do, once its containers have been disconnected: the
    engine removes no network that is in use. PHM is frozen meanwhile: it would put the application back on the old one."""

    name, title, unit = "network_recreated", "network recreated under its name", "network/ros_app"
    condition = "disconnected"
    layer = "container"
    cause = "another project owns the network, and was taken down and started again"
    evidence, evidence_s = "the engine's events of the disconnection and of the new network", 0.1

    _network = ""

    def inject(self, agent: Agent) -> float:
        self._network = first_network(agent)
        sidecar = agent.sidecar
        freeze(sidecar)
        try:
            old = agent.docker.networks.get(self._network).attrs
            moment = time.monotonic()
            _remove(agent, self._network)
            _create(agent, old)
            return moment
        finally:
            sidecar.unpause()

    def clear(self, agent: Agent) -> None:
        if self._network:
            connect_both(agent, self._network)

    def restored(self, agent: Agent) -> bool | None:
        return both_connected(agent, self._network) if self._network else None


def _remove(agent: Agent, name: str) -> None:
    """Disconnect all containers by force, and remove the network."""
    for left in reversed(range(TRIES)):
        network = agent.docker.networks.get(name)
        for container in network.attrs["Containers"] or ():
            network.disconnect(container, force=True)
        try:
            network.remove()
        except NotFound:
            return
        except APIError:  # a container was connected meanwhile
            if not left:
                raise
        else:
            return


def _create(agent: Agent, old: dict[str, Any]) -> None:
    """As Compose created it: the engine chooses the addresses, unless they were given."""
    agent.docker.networks.create(
        old["Name"], driver=old["Driver"], options=old["Options"], labels=old["Labels"], internal=old["Internal"]
    )
