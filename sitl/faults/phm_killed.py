"""PHM itself is killed."""

from __future__ import annotations

import os
import signal
import time

from sitl.faults.base import Agent, Fault

RUN = "bin/phm run"
"""In the daemon's command line, and not in that of the container's first process, which only says `phm run`."""


class Injection(Fault):
    """SIGKILL to PHM's daemon, whose container Docker's restart policy starts again. (`docker kill` would count as a wish to have
    it stopped.) PHM says at its next start that it had ended without a word."""

    name, title, unit = "phm_killed", "PHM killed (SIGKILL)", "companion"
    condition = "phm_restarted"
    level = "WARN"
    layer = "companion"
    healable = False
    passes = True
    cause = "PHM crashed, or the kernel ended it for lack of memory"
    evidence, evidence_s = "the kernel ends the process, and the engine reports the end of its container", 0.1

    _pid = 0

    def inject(self, agent: Agent) -> float:
        self._pid = daemon(agent)
        moment = time.monotonic()
        os.kill(self._pid, signal.SIGKILL)
        return moment

    def clear(self, agent: Agent) -> None:
        sidecar = agent.sidecar
        if sidecar.status != "running":
            sidecar.start()

    def restored(self, agent: Agent) -> bool | None:
        return self._pid not in (pids := agent.processes(agent.sidecar, RUN)) and len(pids) == 1


def daemon(agent: Agent) -> int:
    """The process id of PHM's daemon on this machine."""
    (found,) = agent.processes(agent.sidecar, RUN)
    return found
