"""The application's own HEALTHCHECK fails."""

from __future__ import annotations

import time

from sitl.faults._world import app_runs, exists
from sitl.faults.base import Agent, Fault

MARKER = "/tmp/unhealthy"


class Injection(Fault):
    """Creates the marker that the application's HEALTHCHECK looks for; its next start removes it."""

    name, title, unit = "unhealthy", "healthcheck failing", "health/ros_app"
    condition = "unhealthy"
    layer = "container"
    cause = "the application runs and says of itself that it does not work"
    evidence, evidence_s = "the first run of the HEALTHCHECK that fails, every 3 s in a swarm", 3.2
    evidence_period_s, by_healthcheck = 3.0, True

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.run_in_app("touch", MARKER)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", MARKER)

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent) and not exists(agent.app, MARKER)
