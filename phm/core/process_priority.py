"""The scheduling priority of PHM's own processes, as far as the kernel permits it to change them.

In a container the CPU weight decides (`cpu_shares` in docker/compose.yaml), since the kernel first divides the processor among
containers, and nice only counts within one. For a PHM that runs beside others in one control group nice is what there is.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

from phm.core.settings import ProcessSettings


@dataclass(frozen=True, slots=True)
class Priority:
    """What holds. problem: a sentence when it is not what was asked for, else empty."""

    nice: int
    problem: str = ""


def apply(wanted: ProcessSettings) -> Priority:
    """Set it for the calling thread and all that it starts after; to be called before there are others. Never raises."""
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
    """How readily the kernel ends this process when memory runs out, -1000 to 1000; None: it does not say."""
    try:
        with open("/proc/self/oom_score_adj", encoding="ascii") as stream:
            return int(stream.read())
    except (OSError, ValueError):
        return None
