"""A node runs twice."""

from __future__ import annotations

import time

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault

PID = "/tmp/duplicate.pid"
ENDED = f"for turn in 1 2 3 4 5 6; do kill -0 $(cat {PID}) 2>/dev/null || break; sleep 0.5; done; "


class Injection(Fault):
    """Starts node_1 a second time inside the application container, as someone does by hand who forgot the first."""

    name, title, unit = "node_duplicate", "node runs twice", "nodes/{agent}/node_1"
    condition = "node_duplicate"
    layer = "ros"
    cause = "someone started a node by hand, or two launch files have it"
    evidence, evidence_s = "a second process of the node in the process list", 0.1

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        node = (
            f"ros-entrypoint python -m sitl.application.node --name node_1 --namespace /{agent.name} --publish topic_1:10 "
            f"--subscribe topic_3 </dev/null >/dev/null 2>&1 & echo $! > {PID}"
        )
        moment = time.monotonic()
        agent.run_in_app("sh", "-c", node)  # its number is there when this returns, however busy the engine is
        return moment

    def clear(self, agent: Agent) -> None:
        """After a restart it is gone, and its number may be another's. A node that is starting may ignore SIGTERM."""
        kill = f"kill $(cat {PID}) || true; {ENDED}kill -9 $(cat {PID}) 2>/dev/null || true; "
        kill = kill if agent.generation == self._generation else ""
        agent.run_in_app("sh", "-c", f"if [ -e {PID} ]; then {kill}rm {PID}; fi")

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
