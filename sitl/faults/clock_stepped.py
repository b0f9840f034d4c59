"""The wall clock is set an hour ahead, as NTP or GPS does after the start of a computer without a battery-backed clock."""

from __future__ import annotations

import contextlib
import time

from docker.errors import APIError

from sitl.faults._wall_clock import shift
from sitl.faults.base import Agent, Fault, undoing

OFFSET_S = 3600


class Injection(Fault):
    """Shifts the wall clock of all processes of PHM and the application, and of those alone. The engine and the kernel's file stamps
    keep the machine's clock, and so do processes that are started later."""

    name, title, unit = "clock_stepped", "clock set an hour ahead", "host/clock"
    condition = "clock_step"
    level = "WARN"
    layer = "companion"
    healable = False
    passes = True
    cause = "a time source was found after the start, and the clock was set"
    evidence, evidence_s = "the next reading of the clock", 0.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        with undoing(lambda: self.clear(agent)):
            self._shift(agent, OFFSET_S)
        return moment

    def clear(self, agent: Agent) -> None:
        self._shift(agent, 0)

    @staticmethod
    def _shift(agent: Agent, offset_s: int) -> None:
        for container in (agent.sidecar, agent.app):
            with contextlib.suppress(APIError):  # it does not run
                for pid in agent.processes(container, ""):
                    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has just ended
                        shift(pid, offset_s)
