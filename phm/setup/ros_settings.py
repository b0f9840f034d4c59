"""The ROS settings of PHM's container: the application's own variables and Fast DDS profile, so that PHM finds its nodes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from phm.facts import EnvironmentDifference, RosEnvironment, ros_variables
from phm.facts.ros_environment import MAX_VALUE
from phm.probes.ros.environment_differences import (
    DEFAULT_RMW,
    LOCALHOST,
    differences,
    discovery_range,
    rmw,
    sidecar_variables,
)
from phm.probes.ros.sandbox import PROFILE_VARIABLES
from phm.setup.answers import Network
from phm.setup.machine import Application, Machine

FOLDER = "/etc/phm"
"""Where PHM's container sees the written folder."""
APPLICATION_PROFILE = "application-fastdds.xml"
DEFAULT_BRIDGE = "bridge"
"""Docker resolves no names of containers there."""
_PLAIN = re.compile(r"[A-Za-z0-9_./:;,@=+-]*")


@dataclass(frozen=True, slots=True)
class DetectedRosSettings:
    """lines: of agent.env. profile: a copy of the application's Fast DDS profile, to be written as APPLICATION_PROFILE; empty for none.

    PHM sees the copy in FOLDER, never at the application's own path: the path comes from the application's image, and a mount
    there could replace PHM's code.
    """

    lines: str
    profile: str = ""


def ros_settings(
    machine: Machine, watched: Sequence[Application], shipped_profile: str, network: Network
) -> DetectedRosSettings:
    """shipped_profile: PHM's own for applications, which only shortens leases, so that PHM itself does not need it."""
    found = source(machine, watched)
    if found is None:
        return DetectedRosSettings("# ROS 2: the values of your application.\nROS_DOMAIN_ID=0")
    used = variables(found, watched, network)
    where = "container" if any(one.ros is found for one in watched) else "process"
    lines = [f"# ROS 2: as in {where} {found.name}; PHM must use the same.", *_lines({"ROS_DOMAIN_ID": "0", **used})]
    if need := image_need(found):
        lines.append(f"# {need}")
    if local := _local(watched, network):
        lines.append(
            f"# {', '.join(local)}: the discovery range is LOCALHOST there, so PHM looks there by ROS_STATIC_PEERS."
        )
    if set(local.values()) - {one.name for one in watched}:
        lines.append("# Docker may give a container that is created again another address: then change it here.")
    wanted = _needed(found, network)
    others = [one.name for one in watched if one.ros.variables and _needed(one.ros, network) != wanted]
    if others:
        lines.append(f"# Other values are set in {', '.join(others)}: PHM does not see the nodes there.")
    profile = next((one.profile for one in watched if one.ros is found), "")
    if not profile or profile.strip() == shipped_profile.strip():
        return DetectedRosSettings("\n".join(lines))
    lines += [
        f"# {APPLICATION_PROFILE}, a copy of the application's profile.",
        *(f"{name}={FOLDER}/{APPLICATION_PROFILE}" for name in PROFILE_VARIABLES),
    ]
    return DetectedRosSettings("\n".join(lines), profile)


def source(machine: Machine, watched: Sequence[Application]) -> RosEnvironment | None:
    """Of the watched container with the most ROS variables; without containers, of a process of the host; else None."""
    found = [one.ros for one in watched] or machine.host_ros
    return max(found, key=lambda ros: len(ros.variables), default=None)


def image_need(ros: RosEnvironment) -> str:
    """The middleware that PHM's image must have for this application, in a sentence; empty: the one that it has."""
    name = rmw(ros)
    image = f"PHM's image must have {name}: build it from a ROS base image that does (BASE_IMAGE)."
    return image if name != DEFAULT_RMW else ""


def variables(ros: RosEnvironment, watched: Sequence[Application], network: Network) -> dict[str, str]:
    """What PHM's environment needs on this network to discover the application with `ros`, and watched ones that announce
    themselves only in their own network namespace."""
    peers = [peer for peer in ros.variables.get("ROS_STATIC_PEERS", "").split(";") if peer]
    peers = list(dict.fromkeys((*peers, *_local(watched, network).values())))
    return {**_needed(ros, network), **({"ROS_STATIC_PEERS": ";".join(peers)} if peers else {})}


def remaining_differences(
    environment_file: str, watched: Sequence[Application], network: Network
) -> tuple[tuple[str, EnvironmentDifference], ...]:
    """What may still keep PHM, with this agent.env, from receiving nodes: names of watched containers, each with one difference.

    Containers without ROS variables are left out: most of them do not run ROS.
    """
    pairs = (line.partition("=") for line in environment_file.splitlines() if not line.startswith("#"))
    written = ros_variables({name: value.strip("'") for name, equals, value in pairs if equals})
    phm = RosEnvironment(
        "PHM",
        {"RMW_IMPLEMENTATION": DEFAULT_RMW, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **written},
        network_namespace="host" if network == "host" else "PHM",
        networks=frozenset(name for one in watched for name in one.networks),  # it connects itself to them
        ipc_namespace="PHM",
    )
    compared = (one for one in watched if one.ros.variables)
    return tuple((one.name, difference) for one in compared for difference in differences(one.ros, phm))


def _needed(ros: RosEnvironment, network: Network) -> dict[str, str]:
    return sidecar_variables(ros, same_network=network == "host" == ros.network_namespace)


def _local(watched: Sequence[Application], network: Network) -> dict[str, str]:
    """Watched containers with the range LOCALHOST in another network namespace than PHM's, each with its name or address for PHM."""
    found = {}
    for one in watched:
        if discovery_range(one.ros) == LOCALHOST and not network == "host" == one.ros.network_namespace:
            owner = next((other for other in watched if other.name == one.owner), one)
            named = network == "bridge" and set(owner.networks) - {DEFAULT_BRIDGE}
            addresses = (attachment.address for attachment in owner.fact.networks if attachment.address)
            if peer := owner.name if named else next(addresses, ""):
                found[one.name] = peer
    return found


def _lines(used: Mapping[str, str]) -> list[str]:
    """Lines of an env file. A value that was too long to be kept (`phm.facts.ros_variables`) is not written."""
    return [
        f"{name}={_value(value)}" if len(value) < MAX_VALUE else f"# {name} is too long: copy it from the application."
        for name, value in used.items()
    ]


def _value(text: str) -> str:
    """As Compose reads it from an env file: in single quotes nothing is expanded."""
    if _PLAIN.fullmatch(text):
        return text
    clean = "".join(char for char in text if char.isprintable() and char != "'")
    return f"'{clean}'"
