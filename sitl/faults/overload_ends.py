"""An overload of the machine ends."""

from __future__ import annotations

import time

from sitl.faults._overload import end_overload, overload, overloaded
from sitl.faults.base import Agent, Fault

BEFORE_S = 20.0


class Injection(Fault):
    """20 s of overload by containers that PHM does not know; the fault is its end, after which everything must be OK soon."""

    name, title, unit = "overload_ends", "overload of 20 s ends", "host/cpu"
    condition = "cpu_high"
    layer = "companion"
    cause = "other containers took all cores for a while"
    healable = False
    passes = True
    needs = frozenset({"alone", "starvation"})
    evidence, evidence_s = "the machine's counters of processor time and of tasks that wait", 1.0

    def inject(self, agent: Agent) -> float:
        overload(agent, lasts_s=3 * BEFORE_S)
        try:
            time.sleep(BEFORE_S)
        finally:
            moment = time.monotonic()
            end_overload(agent)
        return moment

    def clear(self, agent: Agent) -> None:
        end_overload(agent)

    def restored(self, agent: Agent) -> bool | None:
        return not overloaded(agent)
