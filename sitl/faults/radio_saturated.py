"""The radio to the ground has more to send than it can."""

from __future__ import annotations

import time

from sitl.faults._world import link
from sitl.faults.base import Agent, Fault

FILL_BPS = 64_000
"""Bits a second; a pair of SiK radios carries about 25 000 each way."""


class Injection(Fault):
    """Foreign traffic beyond what the radio carries fills its transmit buffer. PHM's own lines must still get through."""

    name, title, unit = "radio_saturated", "radio saturated", "radio/router"
    condition = "radio_full"
    layer = "link"
    cause = "stream rates are set too high, or someone loads a log over the radio"
    healable = False
    level = "WARN"
    needs = frozenset({"air"})
    evidence, evidence_s = "the next RADIO_STATUS with a full transmit buffer", 1.0
    evidence_period_s = 1.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "ground", fill_bps=FILL_BPS)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)

    def restored(self, agent: Agent) -> bool | None:
        return bool(link(agent, "ground")["fill_bps"] < FILL_BPS)
