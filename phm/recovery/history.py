"""What was tried on one container, and what of it still counts.

The budget counts every attempt. Back-off and the count of equal failures leave out those that say nothing (any more):

- *eased*: something that the unit needs has come back. Whatever the unit waited for, the next attempt may come at once.
- *excused*: made while something that the unit needs was down, or on an earlier life of the container
  (`phm.recovery.containers.container_generation`). Such a failure has another explanation than the container: counted, it would use up the three
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
class AttemptRecord:
    """One action that was carried out: when it began (monotonic seconds), for what, and whether it was verified."""

    at: float
    unit: str
    condition: str
    action: str
    worked: bool
    backoff_reset: bool = False
    """Back-off does not wait because of it."""
    not_counted: bool = False
    """It is not counted as a failure of the target."""
    partly: bool = False
    """The unit itself came back, and not all that needs it."""


@dataclass(slots=True)
class History:
    """Attempts on one target, newest last, capped. The list is replaced and never changed: any thread may read it."""

    attempts: list[AttemptRecord] = field(default_factory=list)

    def add(self, attempt: AttemptRecord) -> None:
        self.attempts = [*self.attempts, attempt][-KEPT:]

    def within(self, since: float) -> list[AttemptRecord]:
        return [attempt for attempt in self.attempts if attempt.at >= since]

    def reset_backoff(self, units: Collection[str], down_from: float) -> frozenset[str]:
        """Something that `units` need is well again, after it was down from `down_from`; units with an attempt excused."""
        not_counted = {each.unit for each in self.attempts if each.unit in units and each.at >= down_from}
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=each.not_counted or each.at >= down_from)
            if each.unit in units
            else each
            for each in self.attempts
        ]
        return frozenset(not_counted)

    def discount_before(self, since: float) -> bool:
        """A new life of the container began at `since`; whether that excuses anything."""
        old = [each for each in self.attempts if each.at < since and not (each.backoff_reset and each.not_counted)]
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=True) if each.at < since else each for each in self.attempts
        ]
        return bool(old)
