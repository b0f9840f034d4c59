"""The application leaks memory until the kernel's out-of-memory killer ends it."""

from __future__ import annotations

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """Makes the application's first process grow beyond the container's limit (`mem_limit` in the compose file).

    The first process is the largest by then, so it is the one that the kernel ends, and the container with it.
    """

    name, title, unit = "container_oom", "container out of memory", "container/ros_app"
    condition = "oom"
    layer = "container"
    cause = "the application leaks memory, and the kernel ends it at the limit of its container"
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        app.kill(signal="SIGUSR1")
        return died(app, before)

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
