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
HANGS = f"""grep -qs "= $(cut -d' ' -f22 /proc/1/stat) " {PROGRAM} && echo yes || echo no"""
"""Whether it is there and hangs in the present run of the container."""


class Injection(Fault):
    """Puts a program in the place of the HEALTHCHECK's that never returns in this run of the container, as one that asks a hung
    server does. The engine counts it as failed after its timeout, 10 s, or 30 s in a swarm."""

    name, title, unit = "healthcheck_hangs", "healthcheck hangs", "health/ros_app"
    condition = "unhealthy"
    layer = "container"
    cause = "the health check asks a server in the application that accepts connections and never answers"
    evidence = (
        "the first run of the HEALTHCHECK, every 3 s in a swarm, that takes longer than they did so far, up to 1 s"
    )
    evidence_s, evidence_period_s, by_healthcheck = 4.0, 3.0, True

    def inject(self, agent: Agent) -> float:
        started = agent.run_in_app("cut", "-d ", "-f22", "/proc/1/stat")
        agent.run_in_app("mkdir", "-p", PROGRAM.rpartition("/")[0])
        moment = time.monotonic()
        agent.write_in_app(PROGRAM, HANG.format(started=int(started)).encode(), 0o755)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.run_in_app("rm", "-f", PROGRAM)

    def restored(self, agent: Agent) -> bool | None:
        """By the program itself, not by the engine's log of the probes, which is what PHM reads."""
        return works(agent) and agent.run_in_app("sh", "-c", HANGS) == "no"
