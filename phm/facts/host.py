"""The companion computer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


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

    cpu_percent: float | None
    """Use of all cores together since the last reading (at least 0.2 s ago); 0 to 100. None: there was no reading before, so this
    and the other shares of time are not measured yet."""
    memory_percent: float
    memory_available_bytes: int
    disks: tuple[DiskFact, ...]
    load_per_core: float = 0.0
    temperature_c: float | None = None
    temperature_of: str = ""
    throttled: tuple[str, ...] | None = None
    """Reasons such as `under-voltage now`, `frequency capped earlier`; empty: not throttled; None: unknown.

    earlier: in the last seconds or since boot, depending on the kernel.
    """
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
    """Reads the resources of the computer on which PHM runs."""

    def read(self) -> HostFact:
        """Return the newest reading. Raises CannotTell."""
