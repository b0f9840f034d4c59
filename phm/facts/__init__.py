"""Facts that probes report, and the protocols through which checks query the probes.

Probes report what they observe and never judge it. Each method has its own deadline. It raises
`CannotTell` with a sentence if it cannot find out: the check is then STALE, and no recovery
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
    """The other side refused the request for lack of permission (HTTP 403, EACCES)."""


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
    """The address that the user configured (IPAMConfig); empty if Docker chose the address."""


@dataclass(frozen=True, slots=True)
class Mount:
    kind: str
    """bind, volume or tmpfs."""
    source: str
    """Path on the host (for a volume: where the engine stores it)."""
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
    """How the engine runs a container's HEALTHCHECK; the engine's defaults for options that are not set."""

    interval_s: float = 30.0
    timeout_s: float = 30.0
    start_period_s: float = 0.0
    start_interval_s: float = 5.0
    """Interval during the start period; engines before version 25 use `interval_s` then, too."""
    retries: int = 3

    @property
    def decides_s(self) -> float:
        """Longest time from the start of the container until the engine no longer reports `starting`.

        A failed probe does not count if it began within the start period, and the last of these may take up to its timeout.
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
    """The engine's timestamp; together with `id` it identifies one run of the container."""
    exit_code: int = 0
    oom_killed: bool = False
    error: str = ""
    pid: int = 0
    health: str = "none"
    """none, starting, healthy or unhealthy."""
    health_streak: int = 0
    health_output: str = ""
    healthcheck: HealthcheckFact | None = None
    """None: the container has no HEALTHCHECK."""
    restart_count: int = 0
    restart_policy: str = "no"
    network_mode: str = "default"
    pid_mode: str = ""
    """Like `network_mode`, for the PID namespace: `container:...` if it shares that of another container."""
    networks: tuple[Attachment, ...] = ()
    mounts: tuple[Mount, ...] = ()
    devices: tuple[DeviceMapping, ...] = ()
    device_rules: tuple[str, ...] = ()
    privileged: bool = False
    stop_signal: int = 15
    """The signal with which the engine asks it to terminate (StopSignal of the image or the container)."""
    stop_timeout_s: float | None = None
    """How long the engine then waits before SIGKILL, as set for the container (`stop_grace_period`,
    `--stop-timeout`); negative: forever; None: the engine's default, 10 s."""
    cgroup_parent: str = ""
    """The parent cgroup that the user configured; empty: chosen by the engine."""
    cpu_limit: float | None = None
    """CPUs; None: no limit."""
    cpu_period_s: float = 0.1
    """Period to which that limit applies."""
    maintenance: str = ""
    """The label `phm.maintenance`: a maintenance window, in which the container is on hold (`phm.core.maintenance`)."""

    @property
    def running(self) -> bool:
        """The process exists and is not frozen."""
        return self.status == "running"

    @property
    def generation(self) -> str:
        """Identifies one run: changes exactly when the container is recreated or restarted."""
        return f"{self.id}@{self.started_at}"


@dataclass(frozen=True, slots=True)
class EventStreamFact:
    """The engine's event stream. open, since: whether it is open, and since when (monotonic seconds).

    complete_since: no event after this time (monotonic seconds) was missed; infinity: not known.
    """

    open: bool
    since: float
    complete_since: float = float("inf")


COMPLETE = EventStreamFact(True, float("-inf"), float("-inf"))
"""A stream that has always been open and has missed nothing."""


@dataclass(frozen=True, slots=True)
class ProcessFact:
    """One process of a container, as the host's `ps` lists it. Zombies are left out because they have terminated."""

    pid: int
    """Process id on the host, not inside the container."""
    parent: int = 0
    state: str = ""
    """One letter: R running or runnable, S sleeping, D in uninterruptible sleep, T stopped; empty when unknown."""
    cpu_s: float | None = None
    """CPU time used so far, in full seconds; None when unknown."""
    command: str = ""
    """Program and arguments, separated by spaces, at most 4096 characters."""
    age_s: float | None = None
    """Time since it was started, in full seconds, rounded down; None when unknown."""


@dataclass(frozen=True, slots=True)
class FileFact:
    """One path, as `lstat` reports it after links were followed. `sha256` is empty unless it was requested."""

    path: str
    kind: str
    """file, directory or other."""
    size: int
    mode: int
    executable: bool
    sha256: str = ""
    seen_through: str = ""
    """volume or engine: how the file was accessed."""


class DockerProbe(Protocol):
    def engine(self) -> str:
        """Return the version of the engine. Raises CannotTell if it does not answer in time."""

    def container(self, name: str) -> ContainerFact | None:
        """Return the container configured as `name` (its alias), or None if it does not exist.

        Raises CannotTell if the engine does not answer, or if a label matches several containers.
        """

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        """Return the processes of the running container configured as `name`.

        The engine starts a `ps` for each request, so call this only when there is a reason. Raises CannotTell if the
        container is not running, or if the engine does not answer within a second.
        """

    def myself(self) -> ContainerFact | None:
        """Return PHM's own container; None if PHM does not run in a container."""

    def network_id(self, name: str) -> str:
        """Return the id of the network; empty if it does not exist."""

    def reachable(self, address: str) -> bool:
        """Return whether `address` answers within 1 s (ICMP echo, else ARP/TCP evidence)."""


class FileProbe(Protocol):
    def look(self, container: str, path: str, *, digest: bool) -> FileFact | None:
        """Return the file at `path` inside the container, or None if it does not exist.

        Reads a volume mounted into PHM if one contains the path, else asks the engine. With `digest`
        the SHA-256 is calculated, too (cached until size, mtime or inode change).
        """


# ---------------------------------------------------------------- devices and host


@dataclass(frozen=True, slots=True)
class DeviceFact:
    """One device file of the host. `openable` is None if opening it was not tried or proves nothing."""

    path: str
    character: bool
    major: int
    minor: int
    openable: bool | None
    reason: str = ""
    description: str = ""
    """For serial ports, the description from pyserial: product, manufacturer, serial number, USB ids."""
    inode: int = 0
    """Inode of the device file, which changes when the device was removed and is back; 0 when unknown."""


class DeviceProbe(Protocol):
    def look(self, path: str, *, open_it: bool) -> DeviceFact | None:
        """Return the host's device at `path`, or None if it does not exist.

        If `open_it` is false, only the permission bits are checked: opening an idle serial port raises
        DTR, which resets some autopilots and radios.
        """

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        """Return the serial ports that exist now, to be named when an expected one is missing."""


@dataclass(frozen=True, slots=True)
class DiskFact:
    path: str
    used_percent: float
    free_bytes: int
    inodes_used_percent: float = 0.0
    problem: str = ""
    """Why this disk could not be read (such as a hung network mount); the numbers are then meaningless."""
    total_bytes: int = 0
    """Space available to users, used and free; 0: unknown."""


@dataclass(frozen=True, slots=True)
class HostFact:
    """Measurements of the host. None: this machine does not report the value."""

    cpu_percent: float
    """Use of all cores together since the last reading (at least 0.2 s ago); 0 to 100."""
    memory_percent: float
    memory_available_bytes: int
    disks: tuple[DiskFact, ...]
    load_per_core: float = 0.0
    temperature_c: float | None = None
    temperature_of: str = ""
    throttled: tuple[str, ...] | None = None
    """Reasons such as `under-voltage now`, `frequency capped now`; empty: not throttled; None: unknown."""
    clock_synchronized: bool | None = None
    clock_step_s: float = 0.0
    """How far UTC has jumped relative to the monotonic clock since the last reading."""
    fans_rpm: tuple[int, ...] = ()
    waiting_percent: float | None = None
    """Share of the time since the last reading in which a ready task waited for a core; None: not reported by the kernel."""
    memory_stalled_percent: float | None = None
    """Share of that time in which tasks waited for memory and none ran; None: not counted by the kernel."""
    io_stalled_percent: float | None = None
    """The same for disk I/O."""


class HostProbe(Protocol):
    def read(self) -> HostFact: ...


# ---------------------------------------------------------------- PHM itself and all together


@dataclass(frozen=True, slots=True)
class SelfFact:
    """PHM's own health. Empty tuples mean that there are no problems."""

    uptime_s: float
    overdue: tuple[str, ...] = ()
    """Checks that have not finished within their deadline."""
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Events that a slow reporter has lost, by reporter."""
    problems: tuple[str, ...] = ()
    """Sentences, e.g. `log: no space left on /var/log/phm, 12 lines kept in memory`."""
    ros_restarts: int = 0
    ended_badly: bool = False
    """The previous PHM process was killed, crashed, or ended itself because it had stalled."""
    stood_still_s: float | None = None
    """How long the last suspension of the entire PHM process lasted; None: it was never suspended."""
    stood_still_ago_s: float | None = None
    was_stopped: bool = False
    """A signal had suspended it, and the watchdog resumed it."""


class SelfProbe(Protocol):
    def look(self) -> SelfFact: ...


@dataclass(frozen=True)
class World:
    """All probes that a check may query. Passed to `Check.run`; tests build it from `phm.testing`."""

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
