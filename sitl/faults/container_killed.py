"""The application container's first process is killed."""

from __future__ import annotations

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """`docker kill`: SIGKILL, exit code 137. The fault is there when the process has ended, by the engine's own stamp."""

    name, title, unit = "container_killed", "container killed (SIGKILL)", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the application's first process crashed or was killed"
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        app.kill()
        return died(app, before)

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
