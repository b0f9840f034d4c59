"""Somebody freezes the application container."""

from __future__ import annotations

import time

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, freeze


class Injection(Fault):
    """`docker pause`. While the vehicle is disarmed, PHM must be configured to treat it as a failure (`recovery.on_manual_stop`): it is
    an operator's wish otherwise.
    """

    name, title, unit = "container_paused", "container paused", "container/ros_app"
    condition = "paused"
    layer = "container"
    cause = "someone froze the container's processes"
    evidence, evidence_s = "the engine's event that the container is paused", 0.1

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        freeze(agent.app)
        return moment

    def clear(self, agent: Agent) -> None:
        app = agent.app
        if app.status == "paused":
            app.unpause()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
