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
    evidence, evidence_s = "first missed heartbeat", 1.0
    evidence_period_s = 1.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.autopilot(agent.number, "hang")
        return moment

    def restored(self, agent: Agent) -> bool:
        """The link emulator's autopilot sends again."""
        return not agent.links.state()["agents"][agent.number]["autopilot"]["hung"]

    def clear(self, agent: Agent) -> None:
        agent.links.autopilot(agent.number, "resume")
