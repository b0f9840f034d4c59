"""Sections `host` and `pressure`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from phm.core.settings.base import AbsolutePath, Celsius, FaultLimit, Limit, Seconds, Section, UnexpectedLevel


class FreeDiskSettings(Section):
    """Files that PHM may delete when their disk is full."""

    path: AbsolutePath
    """Directory, as PHM sees it; it must be mounted writable, and PHM must be allowed to delete its files."""
    files: Annotated[list[Annotated[str, Field(min_length=1, max_length=255, pattern=r"^[^/]+$")]], Field(min_length=1)]
    """Names, or patterns with `*` and `?`, of the files that may be deleted, in the directory and below."""
    older_than: Annotated[Seconds, Field(ge=10)] = 600.0
    """Seconds since the last change of a file before it may be deleted; PHM must have monitored the clock for as long."""


DevicePattern = Annotated[str, Field(pattern=r"^/dev/([^*?/]+/)*[^/]+$", max_length=255)]


class UnexpectedDevicesSettings(Section):
    """Devices of the host that are not in the configuration."""

    level: UnexpectedLevel = "off"
    """How they are reported. `off`: they are not looked for; `error` opens a fault, which PHM never acts on."""
    watch: Annotated[list[DevicePattern], Field(min_length=1, max_length=32)] = Field(
        default_factory=lambda: ["/dev/ttyUSB*", "/dev/ttyACM*", "/dev/video*", "/dev/sd*"]
    )
    """Which devices are looked for: paths on the host, with `*` and `?` in the last part."""
    ignore: Annotated[list[DevicePattern], Field(max_length=100)] = Field(default_factory=list)
    """Which of them may exist, besides those of `containers[].devices`, `mavlink.endpoints` and `custom`; written as in `watch`."""


class HostSettings(Section):
    """Limits for the companion computer."""

    cpu: Limit = Limit(warn=90, error=98)
    """Share of all cores in use, averaged over `cpu_window`."""
    cpu_window: Annotated[Seconds, Field(ge=1, le=600)] = 10.0
    """Seconds over which CPU use is averaged."""
    cpu_quick: Annotated[Seconds, Field(ge=0, le=600)] = 2.0
    """Shorter window for when no core was idle and tasks had to wait for one, seconds; 0: not used."""
    memory: Limit = Limit(warn=85, error=95)
    """Share of memory that is not available."""
    disk: Limit = Limit(warn=85, error=95)
    """Share of each disk in use."""
    disks: list[AbsolutePath] = Field(default_factory=lambda: ["/"])
    """Paths whose disks are watched, as PHM sees them."""
    free_disk: Annotated[list[FreeDiskSettings], Field(max_length=16)] = Field(default_factory=list)
    """What may be deleted when one of them is full, oldest first."""
    temperature_warn: Celsius = 75.0
    """Degrees Celsius of the hottest sensor of the processor for WARN (a Pi throttles at 80)."""
    temperature_error: Celsius = 85.0
    """Degrees Celsius for ERROR."""
    clock_step: Annotated[Seconds, Field(gt=0)] = 2.0
    """A jump of the UTC clock by more than this is a WARN, unless it is set forward for the first time soon after boot."""
    unexpected_devices: UnexpectedDevicesSettings = UnexpectedDevicesSettings()
    """Devices of the host that are not in the configuration."""
    dev_root: AbsolutePath = "/dev"
    """Where the host's /dev is mounted in PHM's container (docker/compose.yaml: /host/dev)."""


class PressureSettings(Section):
    """When a container or the computer lacks CPU, memory, I/O or processes."""

    window: Annotated[Seconds, Field(ge=1, le=60)] = 2.0
    """Seconds over which the counters of a container are compared."""
    throttled: Limit = Limit(warn=25, error=50)
    """Share of time in which a container is throttled by its CPU limit."""
    waiting: Limit = Limit(warn=75, error=90)
    """Share of time in which all of a container's runnable tasks wait for a CPU, because others use them."""
    memory: Limit = Limit(warn=40, error=60)
    """Share of time in which all tasks of a container waited for memory."""
    memory_faults: FaultLimit = FaultLimit(warn=50, error=200)
    """Pages a second that a container must read back because its memory limit left no room for them."""
    io: Limit = Limit(warn=50, error=75)
    """Share of time in which all tasks of a container waited for the disk, over at least 5 s."""
    pids: Limit = Limit(warn=90, error=100)
    """Share of a container's limit of processes and threads in use."""
    host_memory: Limit = Limit(warn=10, error=30)
    """Share of time in which all tasks of the computer waited for memory, over `host_window`."""
    host_io: Limit = Limit(warn=70, error=95)
    """Share of time in which all tasks of the computer waited for its disks, over `host_window`."""
    host_window: Annotated[Seconds, Field(ge=1, le=600)] = 10.0
    """Averaging window of `host_memory` and `host_io`."""
    cgroups: AbsolutePath = "/sys/fs/cgroup"
    """Where the host's /sys/fs/cgroup is mounted in PHM's container (docker/compose.yaml: /host/cgroup)."""
