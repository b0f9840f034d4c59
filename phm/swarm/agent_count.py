"""The number of agents that share the links, smoothed: heartbeat periods and budgets follow it. Pure.

Where the agents are not listed, any sender can invent some. Silence is measured in heartbeat periods, so a sudden change of the
period would hide a real loss; a slow one costs a large swarm a few minutes of more frequent heartbeats.
"""

from __future__ import annotations

AT_ONCE = 8
"""Up to this many agents have the same, shortest period."""
DOUBLES_S = 60.0
RECENT_S = 120.0
"""An agent that was received within this time counts as a user of the links."""
STEADY = 3
"""A sender counts after this many different heartbeats."""


class SmoothedAgentCount:
    """Smooths the number of agents. Not thread-safe."""

    def __init__(self, agents: int, now: float) -> None:
        self._value, self._at = float(max(1, agents)), now

    def update(self, agents: int, now: float) -> int:
        """The smoothed number at `now` (seconds) when there are `agents`: it at most doubles or halves in a minute."""
        factor = 2.0 ** min((now - self._at) / DOUBLES_S, 60.0)  # PHM may have been frozen for days
        self._at = now
        if agents > self._value:
            self._value = min(float(agents), max(self._value, AT_ONCE) * factor)
        else:
            self._value = max(float(agents), self._value / factor)
        return int(self._value)
