"""The application container is recreated and not started."""

from __future__ import annotations

import time
from functools import partial

from docker.models.containers import Container

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, freeze, undoing


class Injection(Fault):
    """Puts an unstarted copy in the place of the container, as `docker compose up --no-start` does when an image is new.

    The copy takes the name first and the old one goes after, so that it is the copy that PHM finds, and nothing is missing.
    """

    name, title, unit = "container_created", "container recreated, never started", "container/ros_app"
    condition = "created"
    layer = "container"
    cause = "an image was updated and its container recreated but not started"
    evidence, evidence_s = "the engine's event that the container is created", 0.1

    def inject(self, agent: Agent) -> float:
        old = agent.app
        copy = copied(agent, old)
        with undoing(partial(copy.remove, force=True)):
            moment = swap(agent, old, copy)
        old.remove(force=True)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)


def swap(agent: Agent, old: Container, copy: Container) -> float:
    """Give the copy the name of the old one; the moment before.

    Two names cannot be changed in one step. PHM looks within milliseconds, and would rightly report a missing container, so
    it is frozen meanwhile.
    """
    service, sidecar = str(old.name), agent.sidecar
    freeze(sidecar)
    try:
        moment = time.monotonic()
        old.rename(f"{service}-old")
        copy.rename(service)
    finally:
        sidecar.unpause()
    return moment


def copied(agent: Agent, old: Container) -> Container:
    """A container made as `old` was, under another name: same image, labels, mounts, devices, limits, networks, aliases."""
    attrs, short = old.attrs, str(old.id)[:12]
    networks = {
        name: {"Aliases": [alias for alias in network.get("Aliases") or () if alias != short]}
        for name, network in attrs["NetworkSettings"]["Networks"].items()
    }
    config = {key: value for key, value in attrs["Config"].items() if key != "Hostname"}
    made = agent.docker.api.create_container_from_config(  # type: ignore[no-untyped-call]
        {
            **config,
            "Image": attrs["Image"],
            "HostConfig": attrs["HostConfig"],
            "NetworkingConfig": {"EndpointsConfig": networks},
        },
        name=f"{old.name}-new",
    )
    return agent.docker.containers.get(made["Id"])
