"""The wall clock is set an hour ahead, as NTP or GPS does after the start of a computer without a battery-backed clock."""

from __future__ import annotations

import time

from sitl.faults._wall_clock import shift
from sitl.faults.base import Agent, Fault
from sitl.faults.phm_killed import daemon

OFFSET_S = 3600


class Injection(Fault):
    """Shifts the wall clock that PHM's daemon sees, and no other. Programs that wait until a time of the wall clock, as Fast DDS does,
    would wait for an hour: the kernel keeps the clock of the machine. So the nodes and PHM's own ROS process are left alone."""

    name, title, unit = "clock_stepped", "clock set an hour ahead", "host/clock"
    condition = "clock_step"
    level = "WARN"
    layer = "companion"
    healable = False
    cause = "a time source was found after the start, and the clock was set"
    evidence, evidence_s = "the next reading of the clock", 0.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        shift(daemon(agent), OFFSET_S)
        return moment

    def clear(self, agent: Agent) -> None:
        shift(daemon(agent), 0)
