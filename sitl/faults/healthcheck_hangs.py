"""The application's HEALTHCHECK hangs."""

from __future__ import annotations

import time

from sitl.faults._application import works
from sitl.faults.base import Agent, Fault

PROGRAM = "/opt/phm/code/bin/test"
"""Found in PATH before /usr/bin/test, which the HEALTHCHECK runs."""
HANG = """#!/bin/sh
if [ "$(cut -d' ' -f22 /proc/1/stat)" = {started} ]; then exec sleep 3600; fi
exec /usr/bin/test "$@"
"""


class Injection(Fault):
    """Puts a program in the place of the HEALTHCHECK's that never returns in this run of the container, as one that asks a hung
    server does. The engine counts it as failed after its timeout, 10 s, or 30 s in a swarm."""

    name, title, unit = "healthcheck_hangs", "healthcheck hangs", "health/ros_app"
    condition = "unhealthy"
    layer = "container"
    cause = "the health check asks a server in the application that accepts connections and never answers"
    evidence, evidence_s = "the engine's timeout of the first health check that hangs", 33.0
    evidence_period_s = 3.0

    def inject(self, agent: Agent) -> float:
        started = agent.run_in_app("cut", "-d ", "-f22", "/proc/1/stat")
        agent.run_in_app("mkdir", "-p", PROGRAM.rpartition("/")[0])
        moment = time.monotonic()
        agent.write_in_app(PROGRAM, HANG.format(started=int(started)).encode(), 0o755)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", PROGRAM)

    def restored(self, agent: Agent) -> bool | None:
        """Docker's own health of the container: the newest probe has returned 0."""
        probes = (agent.app.attrs["State"].get("Health") or {}).get("Log") or []
        return bool(probes) and probes[-1]["ExitCode"] == 0 and works(agent)
