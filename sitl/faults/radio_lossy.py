"""Something disturbs the radio to the ground."""

from __future__ import annotations

import time

from sitl.faults._world import link
from sitl.faults.base import Agent, Fault

LOSS, BURST = 0.5, 3.0
"""Share of frames that get lost, and how many together on average."""


class Injection(Fault):
    """Half of the frames are damaged, in bursts; RADIO_STATUS counts them. The signal itself is as strong as before."""

    name, title, unit = "radio_lossy", "radio lossy", "radio/router"
    condition = "radio_errors"
    layer = "link"
    cause = "another transmitter is on the frequency of the radio to the ground"
    healable = False
    level = "WARN"
    needs = frozenset({"air"})
    evidence, evidence_s = "the next RADIO_STATUS, one for each HEARTBEAT of the autopilot", 1.0
    evidence_period_s = 1.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "ground", loss=LOSS, burst=BURST)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)

    def restored(self, agent: Agent) -> bool | None:
        return bool(link(agent, "ground")["loss"] < LOSS)
