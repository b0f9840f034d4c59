"""Observations of an agent without PHM: by the engine, connections from this machine, and the emulated links."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

from docker.errors import NotFound
from docker.models.containers import Container

from sitl.faults._application import works
from sitl.faults.base import Agent

CONNECT_S = 0.5
UNUSED_PORT = 9
"""No process listens there, so a kernel that the connection reaches refuses it immediately."""
DISCOVERY_GROUP = "0100FFEF"
"""239.255.0.1 as the kernel prints it on a little-endian machine."""


def runs(container: Container) -> bool:
    """Whether the container runs, and its HEALTHCHECK, if it has one, does not fail. One that has not run yet proves nothing."""
    state = container.attrs["State"]
    health = (state.get("Health") or {}).get("Status", "")
    return bool(state["Running"] and not state["Paused"] and not state["Restarting"] and health != "unhealthy")


def app_runs(agent: Agent) -> bool:
    """Whether the application's container runs, and each of its nodes receives its topics at their rates."""
    return runs(agent.app) and works(agent)


def answers(container: Container) -> bool:
    """Whether the container has an address on each of its networks, and its kernel answers a TCP connection to it."""
    networks = container.attrs["NetworkSettings"]["Networks"]
    return bool(networks) and all(_responds(network["IPAddress"]) for network in networks.values())


def found_by_others(container: Container) -> bool:
    """Whether nodes that start later find those of this container: a socket there has joined the group of DDS discovery on an
    interface that others can reach. A new interface has the address of the old one, but not its groups.
    """
    return joined(Path(f"/proc/{container.attrs['State']['Pid']}/net/igmp").read_text("ascii"))


def joined(igmp: str) -> bool:
    """Whether this content of a /proc/net/igmp has the group of DDS discovery on an interface other than the loopback."""
    device = ""
    for line in igmp.splitlines()[1:]:
        words = line.split()
        if not line.startswith("\t"):
            device = words[1]
        elif words[0] == DISCOVERY_GROUP and device != "lo":
            return True
    return False


def _responds(address: str) -> bool:
    try:
        socket.create_connection((address, UNUSED_PORT), CONNECT_S).close()
    except ConnectionRefusedError:
        return True
    except OSError:
        return False
    return True


def attached(agent: Agent, container: Container, network: str) -> bool:
    """Whether the container is on the network that has this name now, and not on an earlier one."""
    try:
        found = agent.docker.networks.get(network)
    except NotFound:
        return False
    mine = container.attrs["NetworkSettings"]["Networks"].get(network)
    return mine is not None and mine["NetworkID"] == found.id and container.id in found.attrs["Containers"]


def exists(container: Container, path: str) -> bool:
    """Whether the container, running or not, has the path."""
    try:
        container.get_archive(path)
    except NotFound:
        return False
    return True


def network_namespace(container: Container) -> int:
    """The number of the network namespace in which the running container's first process is. Raises OSError."""
    return os.stat(f"/proc/{container.attrs['State']['Pid']}/ns/net").st_ino


def link(agent: Agent, name: str) -> dict[str, Any]:
    """The state of one emulated link of the agent: ``ground``, ``peers``, ``autopilot`` or ``router``."""
    found: dict[str, Any] = agent.links.state()["agents"][agent.number][name]
    return found
