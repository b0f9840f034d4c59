"""Nodes that only PHM's own graph still lists. Pure; callers pass the time.

If a network was disconnected under a node, its last announcement may arrive after its end was processed. This
participant then lists it permanently (seen once, with Jazzy's rmw_fastrtps, for four minutes). A new participant does
not.
"""

from __future__ import annotations

from collections.abc import Mapping

from phm.probes.ros.renewal_pace import RenewalPace

DOUBT_S = 22.0
"""Listed twice for longer than any lease (Fast DDS: 20 s by default): either two nodes of one name are alive, or one is
stale."""


class StaleNodes:
    """Returns the nodes for which a new participant is needed: each once, until it was listed once for as long."""

    def __init__(self, doubt_s: float = DOUBT_S) -> None:
        self._doubt_s = doubt_s
        self._twice_at: dict[str, float] = {}
        self._polled: dict[str, float] = {}
        """Nodes for which that was done, with the time when they were last listed more than once."""
        self._pace = RenewalPace()

    def observe(self, nodes: Mapping[str, int], now: float) -> tuple[str, ...]:
        """nodes: how often each is listed. now: monotonic seconds."""
        twice = {name for name, count in nodes.items() if count > 1}
        self._twice_at = {name: self._twice_at.get(name, now) for name in twice}
        self._polled = {
            name: now if name in twice else at
            for name, at in self._polled.items()
            if name in twice or now - at < self._doubt_s
        }
        due = tuple(
            sorted(
                name for name, at in self._twice_at.items() if now - at >= self._doubt_s and name not in self._polled
            )
        )
        if not due or not self._pace.allows(now):
            return ()
        self._polled.update(dict.fromkeys(due, now))
        return due
