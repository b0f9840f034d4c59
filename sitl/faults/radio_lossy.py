"""The radio to the ground is at the edge of its range."""

from __future__ import annotations

import time

from sitl.faults.base import Agent, Fault

LOSS, BURST = 0.4, 3.0
"""Share of frames that get lost, and how many together on average."""
RSSI, NOISE = 52, 45
"""A margin of 7, 3.7 dB; PHM's limit is 15."""


class Injection(Fault):
    """Loses frames in bursts, and RADIO_STATUS says why: the signal is hardly above the noise."""

    name, title, unit = "radio_lossy", "radio lossy", "radio/router"
    condition = "radio_weak"
    layer = "link"
    cause = "the vehicle is at the edge of its radio's range, or something disturbs it"
    healable = False
    level = "WARN"
    needs = frozenset({"air"})

    def inject(self, agent: Agent) -> float:
        moment = time.monotonic()
        agent.links.set(agent.number, "ground", loss=LOSS, burst=BURST, rssi=RSSI, noise=NOISE)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.links.reset(agent.number)
