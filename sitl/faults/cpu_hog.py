"""Something takes all of the processor."""

from __future__ import annotations

import os
import time

from sitl.faults._load_container import loaded, start_load, stop_load
from sitl.faults.base import Agent, Fault

SPIN = "import os\nfor _ in range({cores} - 1):\n    if not os.fork():\n        break\nwhile True:\n    pass\n"


class Injection(Fault):
    """Runs an endless loop for each core in a container of the lowest weight: it takes what no other process wants, and that is all
    that there is to see. Every agent of this machine sees it."""

    name, title, unit = "cpu_hog", "processor used up", "host/cpu"
    condition = "cpu_high"
    layer = "companion"
    cause = "a process beside the application computes without end"
    evidence, evidence_s = "the counters of processor time have no idle time over one period", 1.0
    healable = False
    needs = frozenset({"alone"})

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        start_load(agent, SPIN.format(cores=os.cpu_count() or 1), cpu_shares=2)
        return moment

    def clear(self, agent: Agent) -> None:
        stop_load(agent)

    def restored(self, agent: Agent) -> bool | None:
        return not loaded(agent)
