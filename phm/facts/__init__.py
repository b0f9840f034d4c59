"""What probes say about the world, and the protocols by which checks ask them.

Probes report what *is*; they never judge. Every method has a deadline of its own and raises
`CannotTell` with a sentence when it could not find out: the check is then STALE, and no recovery
follows. Times named `age_s` are seconds before the call on the monotonic clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from phm.core.clock import Clock
from phm.facts.links import (
    AutopilotFact as AutopilotFact,
    GcsFact as GcsFact,
    LineFact as LineFact,
    LinkFact as LinkFact,
    LinkProbe as LinkProbe,
    RadioFact as RadioFact,
    SenderFact as SenderFact,
)
from phm.facts.pressure import (
    ConsumerFact as ConsumerFact,
    PressureFact as PressureFact,
    PressureProbe as PressureProbe,
    StallFact as StallFact,
)
from phm.facts.ros import (
    BeaconFact as BeaconFact,
    DiagnosticFact as DiagnosticFact,
    EndpointFact as EndpointFact,
    NameFact as NameFact,
    NeighbourFact as NeighbourFact,
    RateFact as RateFact,
    RosFact as RosFact,
    RosProbe as RosProbe,
    TopicFact as TopicFact,
)
from phm.facts.swarm import (
    PeerFact as PeerFact,
    SwarmFact as SwarmFact,
    SwarmProbe as SwarmProbe,
)


class CannotTell(Exception):
    """The probe could not find out; the message says why and what to do."""


class NotPermitted(CannotTell):
    """The other side answered that PHM may not (HTTP 403, EACCES)."""


# ---------------------------------------------------------------- Docker


@dataclass(frozen=True, slots=True)
class Attachment:
    """One network of a container, from NetworkSettings.Networks."""

    name: str
    network_id: str
    address: str
    gateway: str = ""
    aliases: tuple[str, ...] = ()
    fixed_address: str = ""
    """The address asked for by the user (IPAMConfig), empty when Docker chose it."""


@dataclass(frozen=True, slots=True)
class Mount:
    kind: str
    """bind, volume or tmpfs."""
    source: str
    """Path on the host (for a volume: where the engine keeps it)."""
    destination: str
    name: str = ""
    writable: bool = True


@dataclass(frozen=True, slots=True)
class DeviceMapping:
    host_path: str
    container_path: str
    permissions: str = "rwm"


@dataclass(frozen=True, slots=True)
class HealthcheckFact:
    """How the engine runs a container's HEALTHCHECK; the engine's own defaults where nothing is set."""

    interval_s: float = 30.0
    timeout_s: float = 30.0
    start_period_s: float = 0.0
    start_interval_s: float = 5.0
    """Interval within the start period; engines before 25 use `interval_s` there as well."""
    retries: int = 3

    @property
    def decides_s(self) -> float:
        """From the start of the container, at most so long until the engine no longer says `starting`.

        A probe that fails does not count when it began within the start period, and the last of these may take its time-out.
        """
        uncounted_s = self.start_period_s + self.start_interval_s + self.timeout_s
        return uncounted_s + self.retries * (self.interval_s + self.timeout_s)


@dataclass(frozen=True, slots=True)
class ContainerFact:
    """State of one container, from the engine's inspect call."""

    name: str
    id: str
    status: str
    """created, running, paused, restarting, removing, exited or dead."""
    started_at: str
    """The engine's own stamp; with `id` it identifies one life of the container."""
    exit_code: int = 0
    oom_killed: bool = False
    error: str = ""
    pid: int = 0
    health: str = "none"
    """none, starting, healthy or unhealthy."""
    health_streak: int = 0
    health_output: str = ""
    healthcheck: HealthcheckFact | None = None
    """None: the container has none."""
    restart_count: int = 0
    restart_policy: str = "no"
    network_mode: str = "default"
    pid_mode: str = ""
    """As `network_mode`, of its PID namespace: `container:...` where it shares that of another."""
    networks: tuple[Attachment, ...] = ()
    mounts: tuple[Mount, ...] = ()
    devices: tuple[DeviceMapping, ...] = ()
    device_rules: tuple[str, ...] = ()
    privileged: bool = False
    stop_signal: int = 15
    """By which the engine asks it to end (StopSignal of the image or the container)."""
    stop_timeout_s: float | None = None
    """How long the engine then waits before SIGKILL, as the container asks for it (`stop_grace_period`,
    `--stop-timeout`); negative: forever; None: the engine's default, 10 s."""
    cgroup_parent: str = ""
    """The cgroup that the user wants it in; empty: the engine's choice."""
    cpu_limit: float | None = None
    """CPUs; None: no limit."""
    cpu_period_s: float = 0.1
    """Period in which that limit is given out."""
    maintenance: str = ""
    """The label `phm.maintenance`: a time in which the container is on hold (`phm.core.maintenance`)."""

    @property
    def running(self) -> bool:
        """The process exists and is not frozen."""
        return self.status == "running"

    @property
    def generation(self) -> str:
        """Changes exactly when the container is recreated or started again."""
        return f"{self.id}@{self.started_at}"


@dataclass(frozen=True, slots=True)
class EventStreamFact:
    """The engine's event stream. open, since: whether it is open, and since when it is so (monotonic seconds).

    complete_since: nothing that happened after this (monotonic seconds) was missed; infinity: not known.
    """

    open: bool
    since: float
    complete_since: float = float("inf")


COMPLETE = EventStreamFact(True, float("-inf"), float("-inf"))
"""Open forever."""


@dataclass(frozen=True, slots=True)
class ProcessFact:
    """One process of a container, as the host's `ps` lists it. Zombies are left out: they have ended."""

    pid: int
    """Number on the host, not that inside the container."""
    parent: int = 0
    state: str = ""
    """One letter: R on a processor or waiting for one, S asleep, D in the kernel, T stopped; empty when unknown."""
    cpu_s: float | None = None
    """Processor time used so far, in whole seconds; None when unknown."""
    command: str = ""
    """Program and arguments, with a space between, at most 4096 characters."""
    age_s: float | None = None
    """Since it was started, in whole seconds, rounded down; None when unknown."""


@dataclass(frozen=True, slots=True)
class FileFact:
    """One path, as `lstat` sees it after following links. `sha256` is empty unless it was asked for."""

    path: str
    kind: str
    """file, directory or other."""
    size: int
    mode: int
    executable: bool
    sha256: str = ""
    seen_through: str = ""
    """volume or engine: by which way the file was looked at."""


class DockerProbe(Protocol):
    def engine(self) -> str:
        """Version of the answering engine. Raises CannotTell when none answers in time."""

    def container(self, name: str) -> ContainerFact | None:
        """The container configured as `name` (its alias), or None when there is none.

        Raises CannotTell when the engine does not answer, or when a label names several containers.
        """

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        """The processes of the running container configured as `name`.

        The engine starts a `ps` for each question, so ask when there is a reason. Raises CannotTell when the container
        does not run, or the engine cannot tell within a second.
        """

    def myself(self) -> ContainerFact | None:
        """PHM's own container; None when PHM does not run in one."""

    def network_id(self, name: str) -> str:
        """Id of the network, or empty when it does not exist."""

    def reachable(self, address: str) -> bool:
        """Whether `address` answers from here (ICMP echo, else ARP/TCP evidence), within 1 s."""


class FileProbe(Protocol):
    def look(self, container: str, path: str, *, digest: bool) -> FileFact | None:
        """The file at `path` inside the container, or None when it is not there.

        Looks through a volume mounted into PHM where one covers the path, else asks the engine. With
        `digest` the SHA-256 is read too (cached until size, mtime or inode change).
        """


# ---------------------------------------------------------------- devices and host


@dataclass(frozen=True, slots=True)
class DeviceFact:
    """One device file of the host. `openable` is None when opening it was not tried or proves nothing."""

    path: str
    character: bool
    major: int
    minor: int
    openable: bool | None
    reason: str = ""
    description: str = ""
    """For serial ports, pyserial's words: product, maker, serial number, USB ids."""
    inode: int = 0
    """Of the device file: another one after the device was away; 0 when unknown."""


class DeviceProbe(Protocol):
    def look(self, path: str, *, open_it: bool) -> DeviceFact | None:
        """The host's device at `path`, or None when it is not there.

        `open_it` False checks permission bits alone: opening an idle serial port raises DTR, which
        resets some autopilots and radios.
        """

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        """The serial ports that are there now, to be named when an expected one is missing."""


@dataclass(frozen=True, slots=True)
class DiskFact:
    path: str
    used_percent: float
    free_bytes: int
    inodes_used_percent: float = 0.0
    problem: str = ""
    """Why this disk could not be read (a hung network mount); the numbers then mean nothing."""
    total_bytes: int = 0
    """What users may fill, used and free; 0: unknown."""


@dataclass(frozen=True, slots=True)
class HostFact:
    """None: this machine does not report it."""

    cpu_percent: float
    """Of all cores, since the last reading (at least 0.2 s); 0 to 100."""
    memory_percent: float
    memory_available_bytes: int
    disks: tuple[DiskFact, ...]
    load_per_core: float = 0.0
    temperature_c: float | None = None
    temperature_of: str = ""
    throttled: tuple[str, ...] | None = None
    """Words such as `under-voltage now`, `frequency capped now`; empty when none; None when unknown."""
    clock_synchronized: bool | None = None
    clock_step_s: float = 0.0
    """How far UTC has jumped against the monotonic clock since the last reading."""
    fans_rpm: tuple[int, ...] = ()
    waiting_percent: float | None = None
    """Share of that time in which some task was ready and had to wait for a core; None when the kernel does not report it."""
    memory_stalled_percent: float | None = None
    """Share of that time in which tasks waited for memory and none ran; None when the kernel does not count it."""
    io_stalled_percent: float | None = None
    """The same for the disks."""


class HostProbe(Protocol):
    def read(self) -> HostFact: ...


# ---------------------------------------------------------------- PHM itself and all together


@dataclass(frozen=True, slots=True)
class SelfFact:
    """PHM about itself: how its own parts do. Empty tuples mean all is well."""

    uptime_s: float
    overdue: tuple[str, ...] = ()
    """Checks that have not come back within their deadline."""
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Events lost by a slow reporter, by reporter."""
    problems: tuple[str, ...] = ()
    """Sentences, e.g. `log: no space left on /var/log/phm, 12 lines kept in memory`."""
    ros_restarts: int = 0
    ended_badly: bool = False
    """The PHM before this one was killed, crashed, or ended itself because it had stalled."""
    stood_still_s: float | None = None
    """For how long PHM as a whole last did nothing, without having ended; None: never."""
    stood_still_ago_s: float | None = None
    was_stopped: bool = False
    """It was suspended because a signal had stopped it, and was resumed by the watchdog."""


class SelfProbe(Protocol):
    def look(self) -> SelfFact: ...


@dataclass(frozen=True)
class World:
    """Everything a check may ask. Handed to `Check.run`; tests build it from `phm.testing`."""

    clock: Clock
    docker: DockerProbe
    files: FileProbe
    devices: DeviceProbe
    host: HostProbe
    ros: RosProbe
    links: LinkProbe
    swarm: SwarmProbe
    myself: SelfProbe
    pressure: PressureProbe
