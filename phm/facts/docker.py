"""What the Docker Engine says of containers, networks and processes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Attachment:
    """One network of a container, from NetworkSettings.Networks."""

    name: str
    network_id: str
    address: str
    gateway: str = ""
    aliases: tuple[str, ...] = ()
    fixed_addresses: tuple[str, ...] = ()
    """The IPv4 and the IPv6 address that the user configured (IPAMConfig); empty if Docker chose the address."""


@dataclass(frozen=True, slots=True)
class Mount:
    kind: str
    """bind, volume or tmpfs."""
    source: str
    """Path on the host (for a volume: where the engine stores it)."""
    destination: str
    name: str = ""
    writable: bool = True
    subpath: str = ""
    """Of a volume: the only folder of it that is mounted; empty: all of it."""


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
class FailedProbe:
    """A run of the container's HEALTHCHECK that failed."""

    exit_code: int
    """-1: the engine ended it at its timeout, or could not run it."""
    took_s: float | None
    """From its start to its end, by the engine's time stamps; None: they cannot be read."""


@dataclass(frozen=True, slots=True)
class ContainerFact:
    """State of one container, from the engine's inspect call."""

    name: str
    id: str
    status: str
    """created, running, paused, restarting, removing, exited or dead."""
    started_at: str
    """The engine's timestamp; together with `id` it identifies one run of the container."""
    created_at: float | None = None
    """UTC by the engine's clock, which may be set meanwhile; None: unknown. See `phm.core.clock.Clock.latest`."""
    exit_code: int = 0
    oom_killed: bool = False
    error: str = ""
    pid: int = 0
    health: str = "none"
    """none, starting, healthy or unhealthy."""
    health_streak: int = 0
    health_output: str = ""
    failed_probes: tuple[FailedProbe, ...] = ()
    """Those since the last one that passed, oldest first; the engine keeps five."""
    passed_probes_s: tuple[float, ...] = ()
    """How long the runs in the engine's log took that passed, by its time stamps."""
    probe_ended: str = ""
    """The engine's time stamp of the end of the newest run, only to compare it; empty: there is none."""
    healthcheck: HealthcheckFact | None = None
    """None: the container has no HEALTHCHECK."""
    restart_count: int = 0
    restart_policy: str = "no"
    network_mode: str = "default"
    pid_mode: str = ""
    """Like `network_mode`, for the PID namespace: `container:...` if it shares that of another container."""
    ipc_mode: str = ""
    """The same for the IPC namespace, which includes /dev/shm."""
    ros_variables: Mapping[str, str] = field(default_factory=dict, hash=False)
    """Variables of its configured environment that ROS reads (`phm.facts.ros_environment.ROS_VARIABLES`); no others are kept."""
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
    memory_limit: int | None = None
    """Bytes; None: no limit."""
    depends_on: str | None = None
    """The services that Docker Compose starts first, as its label lists them, with conditions; empty: none; None: not by Compose."""
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
    memory_bytes: int | None = None
    """Resident memory, in which shared pages count for each process that uses them; None when unknown."""


@dataclass(frozen=True, slots=True)
class OtherContainer:
    """A container that runs and is not configured. image: as the engine lists it; both are foreign data."""

    name: str
    image: str


class DockerProbe(Protocol):
    """Reads containers and networks from the Docker Engine. Methods raise CannotTell if it does not answer."""

    def engine(self) -> str:
        """Return the version of the engine. Raises CannotTell if it does not answer in time."""

    def container(self, name: str, young_s: float = 0.0) -> ContainerFact | None:
        """Return the container configured as `name` (its alias), or None if it does not exist.

        young_s: an answer of this age is sufficient, unless the engine has reported a change of a container since. It is
        for what is not the subject of the check: a result must not rest on data from before its run.
        Raises CannotTell if the engine does not answer, or if a label matches several containers.
        """

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        """Return the processes of the running container configured as `name`.

        The engine starts a `ps` for each request, so call this only when there is a reason. Raises CannotTell if the
        container is not running, or if the engine does not answer within a second.
        """

    def own_container(self) -> ContainerFact | None:
        """Return PHM's own container; None if PHM does not run in a container."""

    def others(self) -> tuple[OtherContainer, ...]:
        """Return the containers that run, sorted by name, except the configured ones and PHM's own. Raises CannotTell."""

    def network_id(self, name: str) -> str:
        """Return the id of the network; empty if it does not exist."""

    def network_driver(self, name: str) -> str:
        """Return the driver of the network, such as `bridge`; empty if it does not exist."""

    def reachable(self, address: str) -> bool:
        """Return whether `address` answers within 1 s (ICMP echo, else ARP/TCP evidence)."""
