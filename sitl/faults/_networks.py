"""PHM and the application on a network that both have lost."""

from __future__ import annotations

from sitl.faults._world import answers, app_runs, attached, found_by_others, runs
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
    restart_if_lost(agent)


def restart_if_lost(agent: Agent) -> None:
    """Restart an application that was connected again and has not been restarted since: nodes that start later would not find it."""
    app = agent.app
    if runs(app) and not found_by_others(app):
        app.restart(timeout=STOP_S)


def both_connected(agent: Agent, name: str) -> bool:
    """Whether PHM and the running application are on the network, and the application answers and can be found there."""
    app = agent.app
    connected = attached(agent, app, name) and attached(agent, agent.sidecar, name)
    return connected and found_by_others(app) and app_runs(agent) and answers(app)
