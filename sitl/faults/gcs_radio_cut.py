"""The radios to the ground no longer receive each other."""

from __future__ import annotations

import time

from sitl.faults._world import link
from sitl.faults.base import Agent, Fault


class Injection(Fault):
    """The radio on board continues its RADIO_STATUS, so it is the ground station that PHM misses. Other agents report it to the ground."""

    name, title, unit = "gcs_radio_cut", "radio to the ground cut", "gcs"
    condition = "gcs_lost"
    layer = "link"
    cause = "out of range, behind a hill, or the radio on the ground is off"
    healable = False
    needs = frozenset({"air"})
    evidence, evidence_s = "the first HEARTBEAT of the ground station, one a second, that does not arrive", 1.0
    evidence_period_s = 1.0

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "ground", cut=True)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)

    def restored(self, agent: Agent) -> bool | None:
        return not link(agent, "ground")["cut"]
