"""The application's network is removed and created again under its name."""

from __future__ import annotations

import time
from typing import Any

from docker.errors import APIError, NotFound

from sitl.faults._world import answers, app_runs, attached
from sitl.faults.base import STOP_S, Agent, Fault, freeze

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
        self._network = next(iter(agent.app.attrs["NetworkSettings"]["Networks"]))
        sidecar = agent.sidecar
        freeze(sidecar)
        try:
            old = agent.docker.networks.get(self._network).attrs
            _remove(agent, self._network)
            _create(agent, old)
            return time.monotonic()
        finally:
            sidecar.unpause()

    def clear(self, agent: Agent) -> None:
        if not self._network:
            return
        for container, aliases in ((agent.sidecar, []), (agent.app, ["ros_app"])):
            if not attached(agent, container, self._network):
                network = agent.docker.networks.get(self._network)
                if self._network in container.attrs["NetworkSettings"]["Networks"]:
                    network.client.api.disconnect_container_from_network(container.id, self._network, force=True)
                network.connect(container, aliases=aliases)
                if container.id == agent.app.id:
                    # Nodes that were cut off for longer than their lease do not find each other again.
                    container.restart(timeout=STOP_S)

    def restored(self, agent: Agent) -> bool | None:
        if not self._network:
            return None
        app = agent.app
        beside = attached(agent, agent.sidecar, self._network)
        return app_runs(agent) and attached(agent, app, self._network) and answers(app) and beside


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
