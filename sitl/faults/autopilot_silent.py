"""The autopilot hangs."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Its ports stay open and nothing arrives. Reopening PHM's end of the link does not help: an operator must act."""

    name, title, unit = "autopilot_silent", "autopilot hung", "autopilot"
    condition = "autopilot_silent"
    layer = "link"
    cause = "the autopilot hangs, or its power is gone"
    healable = False
    needs = frozenset({"air"})

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.autopilot(agent.number, "hang")
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.autopilot(agent.number, "resume")
