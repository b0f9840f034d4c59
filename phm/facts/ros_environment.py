"""The environment in which ROS runs: of the application, and of PHM. Part of `phm.facts`; import it from there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

ROS_VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
    "ROS_DISCOVERY_SERVER",
    "ROS2_EASY_MODE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "CYCLONEDDS_URI",
    "ZENOH_SESSION_CONFIG_URI",
    "ROS_SECURITY_ENABLE",
    "ROS_DISTRO",
)
"""What decides which nodes a process discovers. Nothing else is read of a container's environment: it may hold secrets."""
MAX_VALUE = 200
"""Longest value of a variable that is kept, in characters."""


def ros_variables(environ: Mapping[str, str]) -> dict[str, str]:
    """Those of `ROS_VARIABLES` that are set, as one printable line each, cut at `MAX_VALUE` characters."""
    return {name: _line(environ[name]) for name in ROS_VARIABLES if environ.get(name)}


def _line(value: str) -> str:
    line = "".join(char if char.isprintable() else "?" for char in value[: MAX_VALUE + 1])
    return line if len(line) <= MAX_VALUE else f"{line[: MAX_VALUE - 3]}..."


@dataclass(frozen=True, slots=True)
class RosEnvironment:
    """The ROS variables and namespaces of one application, or of PHM."""

    name: str
    """What messages call it: the container, or `PHM`."""
    variables: Mapping[str, str] = field(default_factory=dict)
    """Those of `ROS_VARIABLES` that are set."""
    exact: bool = True
    """False: read from the container's configuration. What an entrypoint script sets is not in it."""
    network_namespace: str = ""
    """Equal for processes that share a network namespace: `host`, or the id of the container that owns it; empty: unknown."""
    networks: frozenset[str] = frozenset()
    """Docker networks, by name; empty on the host's network."""
    ipc_namespace: str = ""
    """As `network_namespace`, for /dev/shm."""


@dataclass(frozen=True, slots=True)
class EnvironmentDifference:
    """One difference between the application's ROS environment and PHM's."""

    variable: str
    """One of `ROS_VARIABLES`, `network` or `ipc`."""
    text: str
    """Names the difference and the line to change."""
    certain: bool = True
    """False: it may keep PHM from receiving the application's nodes, or may be harmless."""


class EnvironmentProbe(Protocol):
    """Compares the ROS environment of containers with that of PHM."""

    def differences(self, container: str) -> tuple[EnvironmentDifference, ...]:
        """Return what may keep PHM from receiving nodes of the container configured as `container`, certain ones first.

        Empty if no difference is visible, which does not prove equality. Raises CannotTell if the engine does not answer.
        """
