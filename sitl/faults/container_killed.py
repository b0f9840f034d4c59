"""The application container's first process is killed."""

from __future__ import annotations

import time

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """`docker kill`: SIGKILL, exit code 137. The engine's stamp of the end is up to 0.2 s late."""

    name, title, unit = "container_killed", "container killed (SIGKILL)", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the application's first process crashed or was killed"
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        moment = time.monotonic()
        app.kill()
        died(app, before)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
