"""CRITICAL lines that the operator has not acknowledged. Pure."""

from __future__ import annotations

from phm.gcs.events import GcsEvent

CRITICAL = 2
"""MAV_SEVERITY_CRITICAL; a smaller value is more severe."""


class Alarms:
    """Agents with such lines: `names`, in the order of their first one. Not thread-safe."""

    def __init__(self) -> None:
        self.names: dict[str, int] = {}

    def take(self, event: GcsEvent, name: str) -> bool:
        """Whether this event is a new CRITICAL line of PHM; name: of its agent."""
        body = event.body
        if event.event != "text" or not body["phm"] or body["repeat"] or body["severity"] > CRITICAL:
            return False
        self.names[name] = self.names.get(name, 0) + 1
        return True

    def acknowledge(self) -> None:
        self.names.clear()

    def text(self) -> str:
        """A line for the operator; empty without alarms."""
        count = sum(self.names.values())
        return f"{count} new CRITICAL: {' '.join(self.names)}   a: acknowledge" if count else ""
