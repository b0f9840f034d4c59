"""What a container is kept waiting for, as counters since its start: `phm.facts` explains probes and facts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class StallFact:
    """Seconds that tasks were kept waiting for one resource (the kernel's pressure stall information), since the start."""

    some_s: float
    """At least one task waited."""
    full_s: float | None = None
    """A task waited and none ran; None where the kernel does not count it (for the CPU before Linux 5.13)."""


@dataclass(frozen=True, slots=True)
class PressureFact:
    """Limits and counters of one running container. None means `cannot be seen from here`, or for `no limit`."""

    at: float
    """Monotonic seconds of this reading."""
    source: str
    """`cgroup v2`, `cgroup v1`, or `engine statistics`."""
    generation: str = ""
    """Counters of readings with the same text can be compared."""
    not_seen: tuple[str, ...] = ()
    """What this source does not show, in words."""
    cpu_limit: float | None = None
    """CPUs; None: no limit."""
    cpu_used_s: float | None = None
    cpu_period_s: float = 0.1
    """The limit is granted again in each period."""
    throttled_periods: int | None = None
    """Periods in which the limit was used up."""
    throttled_s: float | None = None
    """Time in which tasks were stopped for that, added up over the machine's CPUs."""
    cpu: StallFact | None = None
    memory: StallFact | None = None
    io: StallFact | None = None
    memory_bytes: int | None = None
    """In use, with the page cache."""
    memory_limit: int | None = None
    reread_pages: int | None = None
    """Pages that a process had to wait for because they had been dropped from memory and were needed again."""
    oom_kills: int | None = None
    pids: int | None = None
    """Processes and threads."""
    pids_limit: int | None = None
    pids_refused: int | None = None
    """Processes and threads that were not started because of the limit."""


@dataclass(frozen=True, slots=True)
class ConsumerFact:
    """Who takes how much of the machine's CPUs."""

    name: str
    """Of the container: its key where it is configured; empty: all that runs outside of containers."""
    cpus: float


class PressureProbe(Protocol):
    def container(self, name: str) -> PressureFact | None:
        """Counters of the container configured as `name`; None when it does not run.

        The engine's statistics are asked for every 2 s at most; until then the last answer is given again. Raises CannotTell.
        """

    def consumers(self) -> tuple[ConsumerFact, ...]:
        """Who takes the CPUs, most first, between this question and the one before. Empty at the first question.

        Costs a look at each container, so ask when there is a reason. Raises CannotTell.
        """
