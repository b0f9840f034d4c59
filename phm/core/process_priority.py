"""The scheduling priority of PHM's own processes, as far as the kernel permits changing it.

In a container the CPU weight decides (`cpu_shares` in docker/compose.yaml), because the kernel divides the CPU among
containers first, and nice applies only within one. For a PHM in the same control group as other programs, nice is the
only means.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from phm.core.settings import ProcessSettings


@dataclass(frozen=True, slots=True)
class Priority:
    """The current value. problem: a sentence if it is not the configured one, else empty."""

    nice: int
    problem: str = ""


def apply(wanted: ProcessSettings) -> Priority:
    """Set it for the calling thread and all threads that it starts later; call it before there are others. Never
    raises."""
    problem, nice = "", os.getpriority(os.PRIO_PROCESS, 0)
    if wanted.nice is not None and wanted.nice != nice:
        try:
            os.setpriority(os.PRIO_PROCESS, 0, wanted.nice)
        except OSError:
            # A limit of 20 - n permits a nice of n (setrlimit(2)).
            problem = (
                f"process.nice {wanted.nice} is not permitted, nice stays {nice}: give PHM's container "
                f"`ulimits: {{nice: {20 - wanted.nice}}}`, or its service `LimitNICE={20 - wanted.nice}`"
            )
    return Priority(os.getpriority(os.PRIO_PROCESS, 0), problem)


def oom_score_adj() -> int | None:
    """The kernel's preference to kill this process when memory runs out, -1000 to 1000; None: unknown."""
    try:
        with open("/proc/self/oom_score_adj", encoding="ascii") as stream:
            return int(stream.read())
    except (OSError, ValueError):
        return None
