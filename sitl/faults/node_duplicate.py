"""A node runs twice."""

from __future__ import annotations

import time

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault

PID = "/tmp/duplicate.pid"
NODE_PID = "/tmp/nodes/node_1.pid"
AGAIN = """
import os, sys
def words(name):
    with open(f"/proc/{sys.argv[1]}/{name}", "rb") as file:
        return file.read().split(b"\\0")[:-1]
command = words("cmdline")
os.execve(command[0], command, dict(each.split(b"=", 1) for each in words("environ")))
"""
"""Becomes what the process with that number is: same rates, and with or without a beacon and its name in the command line."""
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
            f"node=$(cat {NODE_PID}) && {{ python -c '{AGAIN}' $node </dev/null >/dev/null 2>&1 & echo $! > {PID}; }}"
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
