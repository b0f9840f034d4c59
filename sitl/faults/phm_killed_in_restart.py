"""PHM dies while the engine carries out its request to restart the application."""

from __future__ import annotations

import select

from sitl.faults._processes import held, kill
from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault
from sitl.faults.phm_killed import RUN, daemon

ASKED_LIMIT_S = 40.0


class Injection(Fault):
    """Kills node_1, which PHM recovers by a restart of the application, and then PHM's daemon, in the moment in which the
    application's first process has ended: PHM has requested the restart, and the engine has not started the container yet. PHM must
    find its own action under way, and must neither restart a second time nor leave the container stopped."""

    name, title, unit = "phm_killed_in_restart", "PHM killed during its restart", "nodes/{agent}/node_1"
    condition = "node_missing"
    layer = "ros"
    cause = "PHM crashed, or lost its power, between a request to the engine and its end"
    evidence, evidence_s = "the launcher's child has ended (SIGCHLD)", 0.1

    _killed = 0

    def inject(self, agent: Agent) -> float:
        app, phm = agent.app, daemon(agent)
        pid = int(app.attrs["State"]["Pid"])
        with held([pid]) as apps, held([phm]) as daemons:
            if not apps or not daemons:
                raise LookupError(f"{app.name} or PHM does not run")
            moment = agent.signal_node("node_1", "KILL")
            if not select.select(apps, [], [], ASKED_LIMIT_S)[0]:
                raise TimeoutError(f"PHM has not restarted {app.name} within {ASKED_LIMIT_S:g} s")
            kill(daemons[0])
        self._killed = phm
        return moment

    def clear(self, agent: Agent) -> None:
        for container in (agent.app, agent.sidecar):
            if container.status != "running":
                container.start()

    def restored(self, agent: Agent) -> bool | None:
        pids = agent.processes(agent.sidecar, RUN)
        return len(pids) == 1 and self._killed not in pids and app_runs(agent)
