"""Somebody stops the application container."""

from __future__ import annotations

from sitl.faults.base import STOP_S, Agent, Fault, died


class Injection(Fault):
    """`docker stop`. The fault is there when the process has ended, by the engine's own stamp."""

    name, title, unit = "container_stopped", "container stopped", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "somebody or something ended the application in good order"

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        app.stop(timeout=STOP_S)
        return died(app, before)

    def clear(self, agent: Agent) -> None:
        agent.app.start()
