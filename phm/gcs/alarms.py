"""CRITICAL lines that the operator has not acknowledged. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from phm.gcs.events import GcsEvent

CRITICAL = 2
"""MAV_SEVERITY_CRITICAL; a smaller value is more severe."""
MAX_AGENTS = 600
"""Agents whose alarms are kept: a sender can invent any number of agents."""
SHOWN = 12
"""Names in the operator's line."""


class Alarms:
    """Agents with such lines: `names`, in the order of their first one. Not thread-safe."""

    def __init__(self, expected: Iterable[str] = ()) -> None:
        """expected: names of agents whose alarms are kept, and shown first, however many others there are."""
        self._expected = frozenset(expected)
        self.names: dict[str, None] = {}
        self._count = self._left_out = 0

    def take(self, event: GcsEvent, name: str) -> bool:
        """Whether this event is a new CRITICAL line of PHM; name: of its agent."""
        body = event.body
        if event.event != "text" or not body["phm"] or body["repeat"] or body["severity"] > CRITICAL:
            return False
        if name not in self.names and len(self.names) >= MAX_AGENTS:
            del self.names[next(one for one in self.names if one not in self._expected)]
            self._left_out += 1
        self.names[name] = None
        self._count += 1
        return True

    def acknowledge(self) -> None:
        self.names.clear()
        self._count = self._left_out = 0

    def text(self) -> str:
        """A line for the operator; empty without alarms."""
        shown = sorted(self.names, key=lambda name: name not in self._expected)[:SHOWN]
        more = len(self.names) + self._left_out - len(shown)
        names = f"{' '.join(shown)}{f' and {more} more' if more else ''}"
        return f"{self._count} new CRITICAL: {names}   a: acknowledge" if self._count else ""
