"""Somebody stops the application container."""

from __future__ import annotations

from sitl.faults.base import Agent, Fault, mono_of


class Injection(Fault):
    """`docker stop`. The fault is there when the process has ended, by the engine's own stamp."""

    name, title, unit = "container_stopped", "container stopped", "container/ros_app"

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        app.stop(timeout=3)
        for _ in range(50):
            app.reload()
            if app.attrs["State"]["FinishedAt"] != before:
                break
        return mono_of(app.attrs["State"]["FinishedAt"])
