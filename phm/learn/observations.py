"""What `phm learn` has observed. Pure data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from phm.facts import ContainerFact, DeviceFact, EndpointFact, ProcessFact


@dataclass(frozen=True, slots=True)
class ObservedContainer:
    """A running container. key: what the configuration calls it. answers: whether each of its addresses answered, by network; None: not known.

    processes: empty where the engine did not list them. restarted: it was restarted while it was watched.
    """

    fact: ContainerFact
    key: str
    answers: Mapping[str, bool | None] = field(default_factory=dict)
    processes: tuple[ProcessFact, ...] = ()
    restarted: bool = False
    unseen_devices: tuple[str, ...] = ()
    """Devices that are mapped into it, and that PHM does not see on the host."""
    other_devices: tuple[str, ...] = ()
    """What is mapped into it as a device and is a folder or a block device, which PHM does not check."""


@dataclass(frozen=True, slots=True)
class ObservedFolder:
    """A folder of a container with the checksum of each file.

    unstable: files that changed while they were watched. unreadable: files that PHM may not read, and mounts in
    it that PHM does not see.
    """

    container: str
    path: str
    files: Mapping[str, str]
    size: int
    unstable: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ObservedTopic:
    """A topic with at least one publisher. rates: measurements in Hz, one a second. error_hz: their largest uncertainty.

    problem: why there is no rate. changed: publishers or subscribers were added or lost while it was watched.
    """

    name: str
    publishers: tuple[EndpointFact, ...]
    subscribers: tuple[EndpointFact, ...]
    rates: tuple[float, ...] = ()
    error_hz: float = 0.0
    silent: bool = False
    samples: int = 0
    problem: str = ""
    changed: bool = False


@dataclass(frozen=True, slots=True)
class ObservedAutopilot:
    """Heartbeats of an autopilot. longest_s: the longest time between two of them."""

    system: int
    link: str
    heartbeats: int
    longest_s: float


@dataclass(frozen=True, slots=True)
class Observations:
    """Everything that `phm learn` observed.

    watched_s: how long topics were measured. nodes: full name to whether the node was there until the end.
    problems: what could not be observed, in sentences.
    """

    watched_s: float
    containers: tuple[ObservedContainer, ...] = ()
    folders: tuple[ObservedFolder, ...] = ()
    nodes: Mapping[str, bool] = field(default_factory=dict)
    active_nodes: frozenset[str] = frozenset()
    """Full names of the lifecycle nodes that were active all the time."""
    topics: tuple[ObservedTopic, ...] = ()
    late_topics: tuple[str, ...] = ()
    """Topics that appeared after the measurement had begun."""
    other_topics: tuple[str, ...] = ()
    """Topics that are never learned, such as /diagnostics."""
    ports: tuple[DeviceFact, ...] = ()
    autopilots: tuple[ObservedAutopilot, ...] = ()
    problems: tuple[str, ...] = ()
    ros_watched: bool = False
    """Whether the ROS graph was discovered, so that what is not in it was not there."""
