"""The application ends with exit code 0, and its container with it."""

from __future__ import annotations

import time

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """SIGUSR2 to its first process, which ends immediately; `docker stop` would be an operator's wish (`recovery.on_manual_stop`) and
    no fault. Were its nodes ended first, they would be missing while the container still runs, for seconds on a busy machine.

    It counts from the order: the engine's stamp of the end is up to 0.2 s late.
    """

    name, title, unit = "container_stopped", "container stopped", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the application has ended by itself"
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        moment = time.monotonic()
        app.exec_run(["sh", "-c", "kill -USR2 1"])
        died(app, before)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
