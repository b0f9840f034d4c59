"""Other containers want far more processor time than this machine has."""

from __future__ import annotations

import time

from sitl.faults._overload import end_overload, overload, overloaded
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Containers that PHM does not know, eight endless loops for each core, for 60 s. Every agent of this machine sees it."""

    name, title, unit = "host_overload", "host overloaded for 60 s", "host/cpu"
    condition = "cpu_high"
    layer = "companion"
    cause = "perception, mapping and video encoding in other containers take all cores"
    healable = False
    passes = True
    needs = frozenset({"alone", "starvation"})
    evidence, evidence_s = "the machine's counters of processor time and of tasks that wait", 2.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        overload(agent)
        return moment

    def clear(self, agent: Agent) -> None:
        end_overload(agent)

    def restored(self, agent: Agent) -> bool | None:
        return not overloaded(agent)
