"""The autopilot reboots."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """Silent for six seconds, as a real one, which PHM reports as a loss; then it says BOOT, and PHM reports the reboot for half a
    minute. No action is credited."""

    name, title, unit = "autopilot_reboot", "autopilot rebooted", "autopilot"
    condition, earlier = "autopilot_rebooted", "autopilot_silent"
    layer = "link"
    cause = "the autopilot's power dipped, or its watchdog fired"
    healable = False
    level = "WARN"
    passes = True
    needs = frozenset({"air"})
    evidence, evidence_s = (
        "first missed heartbeat; that it is a reboot: the first heartbeat after it, which says BOOT",
        1.0,
    )
    evidence_period_s = 1.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.autopilot(agent.number, "reboot")
        return moment

    def restored(self, agent: Agent) -> bool:
        """The link emulator's autopilot sends again."""
        pilot = agent.links.state()["agents"][agent.number]["autopilot"]
        return not pilot["hung"] and not pilot["rebooting"]

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)
