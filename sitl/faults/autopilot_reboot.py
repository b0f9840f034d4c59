"""The autopilot reboots."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Silent for a second, disarmed, and its time since boot restarts. It is back by itself; PHM reports it for half a minute."""

    name, title, unit = "autopilot_reboot", "autopilot rebooted", "autopilot"
    condition = "autopilot_rebooted"
    layer = "link"
    cause = "the autopilot's power dipped, or its watchdog fired"
    healable = False
    level = "WARN"
    passes = True
    needs = frozenset({"air"})

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.autopilot(agent.number, "reboot")
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)
