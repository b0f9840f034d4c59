"""The application container dies while the machine is overloaded."""

from __future__ import annotations

import time

from sitl.faults._overload import end_overload, overload, overloaded
from sitl.faults._world import app_runs
from sitl.faults.base import Agent, Fault, died, undoing

BEFORE_S = 10.0


class Injection(Fault):
    """`docker kill` after 10 s of an overload that goes on for 50 s."""

    name, title, unit = "overload_container_killed", "container killed during an overload", "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "the application crashed while other containers take all cores"
    also = ("host/cpu",)
    needs = frozenset({"alone", "starvation"})
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def inject(self, agent: Agent) -> float:
        with undoing(lambda: end_overload(agent)):
            overload(agent)
            time.sleep(BEFORE_S)
            app = agent.app
            before = app.attrs["State"]["FinishedAt"]
            moment = time.monotonic()
            app.kill()
            died(app, before)
            return moment

    def clear(self, agent: Agent) -> None:
        end_overload(agent)
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        return app_runs(agent) and not overloaded(agent)
