"""What `phm init` and `phm doctor` found on this machine, as data."""

from __future__ import annotations

from dataclasses import dataclass, field

from phm.facts import ContainerFact, RosEnvironment


@dataclass(frozen=True, slots=True)
class Application:
    """A container that is not PHM's.

    fact:    what the engine says of it.
    project: its Compose project, empty without Compose.
    service: its Compose service, empty without Compose.
    owner:   name of the container whose network namespace it shares, else empty.
    ros:     the ROS variables of its processes, or of its configuration.
    profile: content of its Fast DDS profile; empty when it has none, or when the file cannot be read.
    """

    fact: ContainerFact
    image: str = ""
    project: str = ""
    service: str = ""
    owner: str = ""
    ros: RosEnvironment = field(default_factory=lambda: RosEnvironment(""))
    profile: str = ""

    @property
    def name(self) -> str:
        return self.fact.name

    @property
    def networks(self) -> tuple[str, ...]:
        """Networks that PHM can join; not those that only the engine itself uses."""
        return tuple(one.name for one in self.fact.networks if one.name not in ("host", "none"))


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A serial port of this machine: its stable path, and the group that may open it."""

    path: str
    group_id: int


@dataclass(frozen=True, slots=True)
class Machine:
    """One look at this machine.

    engine:    version of the Docker Engine.
    url:       its address, ``unix:///path`` or ``tcp://host:port``.
    socket_group_id: the group of that socket as containers see it, None when it cannot be read.
    sidecars:  other containers of PHM.
    host_ros:  ROS environments of processes that run without a container and may be read.
    other_devices: mapped paths of the host that are folders or block devices, which PHM does not check.
    """

    engine: str
    url: str
    socket_group_id: int | None
    applications: tuple[Application, ...] = ()
    sidecars: tuple[ContainerFact, ...] = ()
    serial_ports: tuple[SerialPort, ...] = ()
    host_ros: tuple[RosEnvironment, ...] = ()
    other_devices: frozenset[str] = frozenset()

    @property
    def socket(self) -> str:
        """Path of the engine's socket, empty for an engine that is reached over TCP."""
        return self.url.removeprefix("unix://") if self.url.startswith("unix://") else ""

    def application(self, name: str) -> Application | None:
        """The container of that name or Compose service."""
        named = [one for one in self.applications if one.name == name]
        return next(iter(named or [one for one in self.applications if one.service == name]), None)
