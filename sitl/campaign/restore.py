"""Restores an agent to health by force, after any fault or a killed campaign."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from docker.errors import DockerException

from sitl.faults.base import STOP_S
from sitl.faults.file_deleted import put_back
from sitl.swarm.swarm import Swarm, SwarmAgent


def restore(swarm: Swarm, agent: SwarmAgent) -> None:
    """Restore links, router, device, file, networks and configuration; then restart application and PHM. Each step is
    tried separately.
    """
    for step in (_air, _router, _device, _networks, _file, _application, _phm):
        _try(step, swarm, agent)


def _try(step: Callable[[Swarm, SwarmAgent], None], swarm: Swarm, agent: SwarmAgent) -> None:
    with contextlib.suppress(DockerException, LookupError, OSError, RuntimeError, ValueError):
        step(swarm, agent)


def _air(swarm: Swarm, agent: SwarmAgent) -> None:
    swarm.air.split([])
    swarm.air.reset(agent.number)


def _router(_: Swarm, agent: SwarmAgent) -> None:
    agent.router.start()


def _device(_: Swarm, agent: SwarmAgent) -> None:
    agent.make_device()


def _networks(_: Swarm, agent: SwarmAgent) -> None:
    name = f"{agent.project}_net"
    app = agent.app
    if name not in app.attrs["NetworkSettings"]["Networks"]:
        agent.docker.networks.get(name).connect(app, aliases=["ros_app"])


def _file(_: Swarm, agent: SwarmAgent) -> None:
    put_back(agent)


def _application(_: Swarm, agent: SwarmAgent) -> None:
    app = agent.app
    if app.status == "paused":
        app.unpause()
    app.restart(timeout=STOP_S)


def _phm(swarm: Swarm, agent: SwarmAgent) -> None:
    swarm.configure(agent, {})
