"""The application's own HEALTHCHECK fails."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault

MARKER = "/tmp/unhealthy"


class Injection(Fault):
    """Creates the marker that the application's HEALTHCHECK looks for; its next start removes it."""

    name, title, unit = "unhealthy", "healthcheck failing", "health/ros_app"
    condition = "unhealthy"
    layer = "container"
    cause = "the application runs and says of itself that it does not work"

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.run_in_app("touch", MARKER)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", MARKER)
