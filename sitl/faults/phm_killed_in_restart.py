"""PHM dies while the engine carries out its request to restart the application."""

from __future__ import annotations

import os
import signal
import time

from sitl.faults._world import app_runs, exists
from sitl.faults.base import Agent, Fault
from sitl.faults.phm_killed import RUN, daemon
from sitl.faults.unhealthy import MARKER

ASKED_LIMIT_S = 40.0
POLL_S = 0.005


class Injection(Fault):
    """Makes the HEALTHCHECK fail, and kills PHM's daemon in the moment in which the application's first process has ended: PHM has
    requested the restart, and the engine has not started the container yet. PHM must find its own action under way, and must
    neither restart a second time nor leave the container stopped."""

    name, title, unit = "phm_killed_in_restart", "PHM killed during its restart", "health/ros_app"
    condition = "unhealthy"
    layer = "container"
    cause = "PHM crashed, or lost its power, between a request to the engine and its end"
    evidence, evidence_s = "the first run of the HEALTHCHECK that fails, every 3 s in a swarm", 3.2

    _killed = 0

    def inject(self, agent: Agent) -> float:
        app, phm = agent.app, daemon(agent)
        pid = int(app.attrs["State"]["Pid"])
        moment = time.monotonic()
        agent.run_in_app("touch", MARKER)
        while os.path.exists(f"/proc/{pid}"):
            if time.monotonic() - moment > ASKED_LIMIT_S:
                raise TimeoutError(f"PHM has not restarted {app.name} within {ASKED_LIMIT_S:g} s")
            time.sleep(POLL_S)
        os.kill(phm, signal.SIGKILL)
        self._killed = phm
        return moment

    def clear(self, agent: Agent) -> None:
        for container in (agent.app, agent.sidecar):
            if container.status != "running":
                container.start()
        agent.run_in_app("rm", "-f", MARKER)

    def restored(self, agent: Agent) -> bool | None:
        pids = agent.processes(agent.sidecar, RUN)
        return len(pids) == 1 and self._killed not in pids and app_runs(agent) and not exists(agent.app, MARKER)
