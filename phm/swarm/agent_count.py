"""How many agents share the links, as heartbeat periods and budgets follow it: it changes slowly. Pure.

Where the agents are not listed, anybody can send heartbeats of made-up ones. Silence is measured in heartbeat periods, so a
sudden jump of the period would hide a real loss; a slow one costs a large swarm a few minutes of denser heartbeats.
"""

from __future__ import annotations

AT_ONCE = 8
"""Up to so many agents have the same, shortest period."""
DOUBLES_S = 60.0
RECENT_S = 120.0
"""Who was heard within this time sends on the links."""
STEADY = 3
"""So many different heartbeats make a sender count."""


class SmoothedAgentCount:
    """Not thread-safe."""

    def __init__(self, agents: int, now: float) -> None:
        self._value, self._at = float(max(1, agents)), now

    def update(self, agents: int, now: float) -> int:
        """How many to count with at `now`, seconds, when there are so many: at most twice or half as many a minute."""
        factor = 2.0 ** ((now - self._at) / DOUBLES_S)
        self._at = now
        if agents > self._value:
            self._value = min(float(agents), max(self._value, AT_ONCE) * factor)
        else:
            self._value = max(float(agents), self._value / factor)
        return int(self._value)
