"""PHM itself hangs."""

from __future__ import annotations

import contextlib
import os
import signal
import time

import psutil

from sitl.faults.base import Agent, Fault
from sitl.faults.phm_killed import RUN, daemon


class Injection(Fault):
    """SIGSTOP to PHM's daemon: it is there and does nothing. Its guard notices, and lets it go on."""

    name, title, unit = "phm_stopped", "PHM hung (SIGSTOP)", "companion"
    condition = "phm_suspended"
    level = "WARN"
    layer = "companion"
    healable = False
    passes = True
    cause = "the entire daemon hangs: stopped, or held by a library that never returns"
    evidence, evidence_s = "the kernel's state of the process, as its watchdog reads it every 0.25 s", 0.25
    evidence_period_s = 0.25

    _pid = 0

    def inject(self, agent: Agent) -> float:
        self._pid = daemon(agent)
        moment = time.monotonic()
        os.kill(self._pid, signal.SIGSTOP)
        return moment

    def clear(self, agent: Agent) -> None:
        if self._pid and self._pid in agent.processes(agent.sidecar, RUN):
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGCONT)

    def restored(self, agent: Agent) -> bool | None:
        return psutil.Process(self._pid).status() != psutil.STATUS_STOPPED if self._pid else None
