"""Resources that a container has to wait for, as counters since its start. `phm.facts` explains probes and facts."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol


class CgroupState(str, Enum):
    """What the kernel shows about the processes of a container."""

    RUNNING = "running"
    FROZEN = "frozen"
    """`docker pause` does this."""
    EMPTY = "empty"
    """None is left. The Docker Engine removes the cgroup then, so it has not dealt with the end yet."""
    REMOVED = "removed"
    """The cgroup does not exist any more: something has dealt with the container's end."""


@dataclass(frozen=True, slots=True)
class StallFact:
    """Seconds that tasks waited for one resource since the start (pressure stall information of the kernel)."""

    some_s: float
    """At least one task waited."""
    full_s: float | None = None
    """At least one task waited and none ran; None if the kernel does not count it (for the CPU before Linux 5.13)."""


@dataclass(frozen=True, slots=True)
class PressureFact:
    """Limits and counters of one running container. None: not visible to PHM, or, for a limit, that there is none."""

    at: float
    """Monotonic seconds of this reading."""
    source: str
    """`cgroup v2`, `cgroup v1`, or `engine statistics`."""
    generation: str = ""
    """Counters of two readings can be compared if this text is the same."""
    not_seen: tuple[str, ...] = ()
    """Descriptions of what this source does not provide."""
    cpu_limit: float | None = None
    """CPUs; None: no limit."""
    cpu_used_s: float | None = None
    cpu_period_s: float = 0.1
    """The limit applies to each period."""
    throttled_periods: int | None = None
    """Periods in which the limit was reached."""
    throttled_s: float | None = None
    """Time for which tasks were paused by the limit, the sum over all CPUs of the machine."""
    cpu: StallFact | None = None
    memory: StallFact | None = None
    io: StallFact | None = None
    memory_bytes: int | None = None
    """Memory in use, including the page cache."""
    without_cache_bytes: int | None = None
    """Memory in use without pages of files, which the kernel can evict; up to 10 s old."""
    memory_limit: int | None = None
    reread_pages: int | None = None
    """Pages that were evicted from memory and needed again, so that a process had to wait for them (refaults)."""
    oom_kills: int | None = None
    """Processes that the kernel killed for lack of memory, whether the container or the computer lacked it."""
    memory_limit_hits: int | None = None
    """How often the container reached its own memory limit: rises before the kernel kills a process because of that limit."""
    pids: int | None = None
    """Processes and threads."""
    pids_limit: int | None = None
    pids_refused: int | None = None
    """Processes and threads that could not be started because of the limit."""


@dataclass(frozen=True, slots=True)
class ConsumerFact:
    """CPU use of one consumer on this machine."""

    name: str
    """Name of the container, or its key if it is configured; empty: everything that runs outside of containers."""
    cpus: float


class PressureProbe(Protocol):
    """Reads what containers use and what they wait for."""

    def container(self, name: str) -> PressureFact | None:
        """Return the counters of the container configured as `name`; None if it is not running.

        The engine's statistics are requested at most every 2 s; in between, the last answer is returned. Raises CannotTell.
        """

    def state(self, name: str, container_id: str) -> CgroupState | None:
        """Return the state of the processes of the container configured as `name`, without asking the engine.

        None: unknown, because the cgroup of the container with this id (64 digits) has not been found since PHM started.
        """

    def consumers(self) -> tuple[ConsumerFact, ...]:
        """Return the CPU use of all consumers, highest first, each between its last two readings. Empty for the first call.

        Reads each container, so call this only when there is a reason. Without cgroups the engine is asked, about some containers
        in each call and about all in turn. Raises CannotTell.
        """
