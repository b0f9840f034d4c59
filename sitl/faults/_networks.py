"""PHM and the application on a network that both have lost."""

from __future__ import annotations

from sitl.faults._world import answers, app_runs, attached
from sitl.faults.base import STOP_S, Agent


def first_network(agent: Agent) -> str:
    """The name of the application's first network."""
    return str(next(iter(agent.app.attrs["NetworkSettings"]["Networks"])))


def connect_both(agent: Agent, name: str) -> None:
    """Connect what is not on the network of this name. Doing it twice is harmless."""
    network = agent.docker.networks.get(name)
    for container, aliases in ((agent.sidecar, []), (agent.app, ["ros_app"])):
        if attached(agent, container, name):
            continue
        if name in container.attrs["NetworkSettings"]["Networks"]:
            network.disconnect(container, force=True)
        network.connect(container, aliases=aliases)
        if aliases:
            # Nodes that were cut off for longer than their lease do not find each other again.
            container.restart(timeout=STOP_S)


def both_connected(agent: Agent, name: str) -> bool:
    """Whether PHM and the running application are on the network, and the application's address answers."""
    app = agent.app
    connected = attached(agent, app, name) and attached(agent, agent.sidecar, name)
    return connected and app_runs(agent) and answers(app)
