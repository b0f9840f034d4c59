"""The lives of containers: a new one is told once, whoever notices it first, the engine's event or a check.

Events are quick and get lost; a check says in each result which life it saw, and is asked before anything that needs
the container is told, so that it cannot miss the life in which that happens.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class StartSeen(Enum):
    """What a run has seen: the life that was known, one that an event had announced, or one that no event has reported."""

    KNOWN = "known"
    ANNOUNCED = "announced"
    NEWS = "news"


@dataclass(slots=True)
class _Life:
    """`seen` is the life that a check saw last. At most one of the last two is set: who alone told of the newest life."""

    teller: str = ""
    """The unit that tells the lives of this container: two that name them differently would tell of new ones for ever."""
    seen: str = ""
    heard_at: float | None = None
    """An event told of it then (monotonic seconds); no run that began since has come back."""
    unheard: bool = False
    """A check saw it; its event has not come, or never will."""


class StartDedup:
    """By target. An event that never came swallows at most the next one, whose life the check then tells."""

    def __init__(self) -> None:
        self._of: dict[str, _Life] = {}

    def newest(self, target: str) -> str:
        """The life of the container that a check saw last; empty: none."""
        life = self._of.get(target)
        return life.seen if life is not None else ""

    def heard(self, target: str, now: float) -> bool:
        """An event says that the container has been started; whether that is news."""
        life = self._of.setdefault(target, _Life())
        if life.unheard:
            life.unheard = False
            return False
        life.heard_at = now
        return True

    def saw(self, target: str, unit: str, seen: str, started: float) -> StartSeen:
        """A run that began at `started` saw this life. The first one ever seen is no news."""
        life = self._of.setdefault(target, _Life())
        life.teller = life.teller or unit
        if unit != life.teller:
            return StartSeen.KNOWN
        changed, heard = life.seen not in ("", seen), life.heard_at is not None
        life.seen = seen
        if life.heard_at is not None and (changed or started >= life.heard_at):
            life.heard_at = None
        if changed and not heard:
            life.unheard = True
        if not changed:
            return StartSeen.KNOWN
        return StartSeen.ANNOUNCED if heard else StartSeen.NEWS
