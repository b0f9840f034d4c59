"""The application ends at every start."""

from __future__ import annotations

import time

from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died

MARKER = "/tmp/broken_start"
"""Not empty: the application's launcher ends with 1. It lives in the container's own layer, so it stays over restarts."""


class Injection(Fault):
    """Makes every start fail, then kills the container. PHM must stop restarting and say so; an operator fixes the cause."""

    name, title, unit = "crash_loop", "container ends at every start", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the application itself ends at every start"
    healable = False
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        agent.write_in_app(MARKER, b"1\n")
        moment = time.monotonic()
        app.kill()
        died(app, before)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.write_in_app(MARKER, b"")
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent)
