"""A node runs twice."""

from __future__ import annotations

import time

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault

PID = "/tmp/duplicate.pid"


class Injection(Fault):
    """Starts node_1 a second time inside the application container, as somebody does by hand who forgot the first."""

    name, title, unit = "node_duplicate", "node runs twice", "nodes/{agent}/node_1"
    condition = "node_duplicate"
    layer = "ros"
    cause = "somebody started a node by hand, or two launch files have it"
    evidence, evidence_s = "a second process of the node in the process list", 0.1

    _generation = ""

    def inject(self, agent: Agent) -> float:
        self._generation = agent.generation
        node = (
            f"echo $$ > {PID}; exec ros-entrypoint python -m sitl.application.node --name node_1 --namespace /{agent.name} "
            "--publish topic_1:10 --subscribe topic_3"
        )
        moment = time.monotonic()
        agent.app.exec_run(["sh", "-c", node], detach=True)
        return moment

    def clear(self, agent: Agent) -> None:
        """After a restart it is gone, and its number may be another's."""
        kill = f"kill $(cat {PID}) || true; " if agent.generation == self._generation else ""
        agent.run_in_app("sh", "-c", f"if [ -e {PID} ]; then {kill}rm {PID}; fi")

    def restored(self, agent: Agent) -> bool | None:
        return works(agent)
