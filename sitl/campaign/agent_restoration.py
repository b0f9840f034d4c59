"""Restores an agent to health by force, after any fault or a killed campaign."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from docker.errors import DockerException

from sitl.faults._load_container import stop_load
from sitl.faults._overload import end_overload
from sitl.faults.file_deleted import put_back
from sitl.swarm import startup
from sitl.swarm.swarm import Swarm, SwarmAgent


def restore(swarm: Swarm, agent: SwarmAgent) -> None:
    """End loads; restore links, router and device; recreate the application; restore its file; restart PHM with its
    configuration. Each step is tried separately.
    """
    for step in (_loads, _air, _router, _device, _application, _file, _phm):
        _try(step, swarm, agent)


def _try(step: Callable[[Swarm, SwarmAgent], None], swarm: Swarm, agent: SwarmAgent) -> None:
    with contextlib.suppress(DockerException, LookupError, OSError, RuntimeError, ValueError):
        step(swarm, agent)


def _loads(_: Swarm, agent: SwarmAgent) -> None:
    end_overload(agent)
    stop_load(agent)


def _air(swarm: Swarm, agent: SwarmAgent) -> None:
    swarm.air.split([])
    swarm.air.reset(agent.number)


def _router(_: Swarm, agent: SwarmAgent) -> None:
    agent.router.start()


def _device(_: Swarm, agent: SwarmAgent) -> None:
    agent.make_device()


def _file(_: Swarm, agent: SwarmAgent) -> None:
    put_back(agent)


def _application(swarm: Swarm, agent: SwarmAgent) -> None:
    """A new container has no changed limits, firewall rules or networks."""
    if agent.app.status == "paused":
        agent.app.unpause()
    startup.recreate(swarm, agent, "ros_app")


def _phm(swarm: Swarm, agent: SwarmAgent) -> None:
    if agent.sidecar.status == "paused":
        agent.sidecar.unpause()
    swarm.configure(agent, {})
