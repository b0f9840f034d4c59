"""What the operator of `phm init` decides, and the defaults that follow from the machine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from phm.setup.machine import Application, Machine
from phm.transport.own_network import HOST_NAME

Network = Literal["bridge", "host"]
IMAGE = "phm-sidecar:dev"
NO_MAVLINK = "none"
GROUND_PORT = 14550
"""The port at which ground stations listen."""
DELIVERED, DELIVERY_KEY = "delivered", "delivered/delivery.key"
"""The folder that PHM may write to if configurations are delivered, and the key of the operator."""


@dataclass(frozen=True, slots=True)
class Answers:
    """All decisions.

    containers:      names of the containers to watch, in order.
    recover:         whether PHM may start, restart, unpause and reconnect them.
    flight_critical: names of those that are not restarted while the vehicle may be armed; only with `recover` and MAVLink.
    mavlink:         url of the MAVLink endpoint, or NO_MAVLINK.
    logs:            folder of the log, relative to the compose file or absolute.
    nodes:           names of ROS nodes with the container each one runs in, empty where that is not known.
    deliver:         address and port at which configurations may be delivered; None: the configuration is read-only for PHM.
    """

    name: str
    id: int
    containers: tuple[str, ...]
    recover: bool
    mavlink: str
    network: Network
    flight_critical: tuple[str, ...] = ()
    image: str = IMAGE
    logs: str = "./logs"
    nodes: tuple[tuple[str, str], ...] = ()
    deliver: tuple[str, int] | None = None

    @property
    def configuration(self) -> str:
        """The file of the configuration, relative to the folder."""
        return f"{DELIVERED}/phm.yaml" if self.deliver else "phm.yaml"


class UnknownContainer(Exception):
    """A container that this engine does not have; the message lists those that it has."""


def containers(machine: Machine, wanted: Sequence[str]) -> tuple[Application, ...]:
    """The applications with these names or Compose services (none given: all that run), and the containers whose network
    namespace they share. Raises UnknownContainer."""
    found: dict[str, Application] = {}
    for name in wanted or [one.name for one in machine.applications if one.fact.running]:
        application = machine.application(name)
        if application is None:
            known = ", ".join(one.name for one in machine.applications) or "none"
            raise UnknownContainer(f"there is no container {name}; running containers: {known}")
        owner = machine.application(application.owner) if application.owner else None
        for one in (owner, application):
            if one is not None:
                found[one.name] = one
    return tuple(found.values())


def network(applications: Sequence[Application]) -> Network:
    """`host` when one of them uses the host's network, or there is none, so that ROS runs on the host: discovery does not reach
    from a bridge to the host's network, but from there to a bridge."""
    bridged = applications and all(one.fact.network_mode != "host" for one in applications)
    return "bridge" if bridged else "host"


def ground(chosen: Network) -> str:
    """The endpoint that reaches a ground station on this machine."""
    return f"udpout:{'127.0.0.1' if chosen == 'host' else HOST_NAME}:{GROUND_PORT}"


def keys(applications: Sequence[Application]) -> dict[str, str]:
    """By name of the container what phm.yaml calls it: its Compose service where that is unique, else its name."""
    services = [one.service for one in applications]
    taken = {one.name for one in applications}
    return {
        one.name: one.service
        if one.service and services.count(one.service) == 1 and one.service not in taken - {one.name}
        else one.name
        for one in applications
    }
