"""Count each container start once, whether Docker's event or a check notices it first.

Events are fast but can be lost. A check reports in each result which run (generation) of the container it saw, and it runs again
before a fault of a dependent is published, so it cannot miss the generation in which that happens.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class StartSeen(Enum):
    """What a check has seen: the known generation, one that an event had announced, or one without an event."""

    KNOWN = "known"
    ANNOUNCED = "announced"
    NEW = "new"


@dataclass(slots=True)
class _Starts:
    """Of one target. `seen` is the generation that a check saw last. At most one of the last two fields is set."""

    reporter: str = ""
    """The one unit whose reports count: two that name generations differently would report new starts endlessly."""
    seen: str = ""
    event_at: float | None = None
    """When an event announced a start (monotonic seconds) that no check has confirmed yet."""
    awaits_event: bool = False
    """A check saw the start before its event, which may never arrive."""


class StartDedup:
    """By target. A lost event hides at most the next one, whose start the check then reports."""

    def __init__(self) -> None:
        self._of: dict[str, _Starts] = {}

    def newest(self, target: str) -> str:
        """The generation of the container that a check saw last; empty: none."""
        known = self._of.get(target)
        return known.seen if known is not None else ""

    def on_event(self, target: str, now: float) -> bool:
        """An event reports a start of the container. Return whether it is new."""
        known = self._of.setdefault(target, _Starts())
        if known.awaits_event:
            known.awaits_event = False
            return False
        known.event_at = now
        return True

    def on_result(self, target: str, unit: str, seen: str, started: float) -> StartSeen:
        """A run that began at `started` saw this generation. The first one ever seen is not a start."""
        known = self._of.setdefault(target, _Starts())
        known.reporter = known.reporter or unit
        if unit != known.reporter:
            return StartSeen.KNOWN
        changed, announced = known.seen not in ("", seen), known.event_at is not None
        known.seen = seen
        if known.event_at is not None and (changed or started >= known.event_at):
            known.event_at = None
        if changed and not announced:
            known.awaits_event = True
        if not changed:
            return StartSeen.KNOWN
        return StartSeen.ANNOUNCED if announced else StartSeen.NEW
