"""What was tried on one container, and what of it still counts.

The budget counts every attempt. Back-off and the count of equal failures leave out those that say nothing (any more):

- *eased*: something that the unit needs has come back. Whatever the unit waited for, the next attempt may come at once.
- *excused*: made while something that the unit needs was down, or on an earlier life of the container
  (`phm.recovery.lives`). Such a failure has another explanation than the container: counted, it would use up the three
  attempts before one was made under which the container could have become well.

Both are bounded by the budget alone, so a dependency that flaps costs no more actions than the budget allows.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace

CLEAN_S = 600.0
"""After this long without an attempt, counts and back-off start again."""
KEPT = 100
"""Attempts remembered per target; more than any budget allows."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """One action that was carried out: when it began (monotonic seconds), for what, and whether it was verified."""

    at: float
    unit: str
    condition: str
    action: str
    worked: bool
    eased: bool = False
    """Back-off does not wait because of it."""
    excused: bool = False
    """It is not counted as a failure of the target."""
    partly: bool = False
    """The unit itself came back, and not all that needs it."""


@dataclass(slots=True)
class History:
    """Attempts on one target, newest last, capped. The list is replaced and never changed: any thread may read it."""

    attempts: list[Attempt] = field(default_factory=list)

    def add(self, attempt: Attempt) -> None:
        self.attempts = [*self.attempts, attempt][-KEPT:]

    def within(self, since: float) -> list[Attempt]:
        return [attempt for attempt in self.attempts if attempt.at >= since]

    def ease(self, units: Collection[str], down_from: float) -> frozenset[str]:
        """Something that `units` need is well again, after it was down from `down_from`; units with an attempt excused."""
        excused = {each.unit for each in self.attempts if each.unit in units and each.at >= down_from}
        self.attempts = [
            replace(each, eased=True, excused=each.excused or each.at >= down_from) if each.unit in units else each
            for each in self.attempts
        ]
        return frozenset(excused)

    def begin_anew(self, since: float) -> bool:
        """A new life of the container began at `since`; whether that excuses anything."""
        old = [each for each in self.attempts if each.at < since and not (each.eased and each.excused)]
        self.attempts = [replace(each, eased=True, excused=True) if each.at < since else each for each in self.attempts]
        return bool(old)
