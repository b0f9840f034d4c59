"""A ROS node dies without a word (SIGKILL), its container lives on."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Kills node_1 by its process id inside the application container."""

    name, title, unit = "node_killed", "node killed (SIGKILL)", "nodes/{agent}/node_1"

    def inject(self, agent: Agent) -> float:
        pid = int(agent.run_in_app("cat", "/tmp/nodes/node_1.pid"))
        moment = time.monotonic()
        agent.run_in_app("kill", "-KILL", str(pid))
        return moment
