"""The application ends in good order, and its container with it."""

from __future__ import annotations

from sitl.faults.base import Agent, Fault, died


class Injection(Fault):
    """SIGTERM to its first process, from inside; `docker stop` would be an operator's wish (`recovery.on_manual_stop`) and no fault.

    The fault is there when the process has ended, by the engine's own stamp.
    """

    name, title, unit = "container_stopped", "container stopped", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "something ended the application in good order"

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        app.exec_run(["sh", "-c", "kill -TERM 1"])
        return died(app, before)

    def clear(self, agent: Agent) -> None:
        agent.app.start()
