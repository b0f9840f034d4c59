"""What was tried on one target, and which attempts count against the next one. Pure.

The budget counts every attempt. Two flags keep an attempt out of back-off and out of the count of failures:

- `backoff_reset`: something that the unit needs has recovered since, so the next attempt may follow immediately.
- `not_counted`: made while something that the unit needs was down, or on an earlier generation of the container
  (`phm.recovery.containers.container_generation`). The container did not cause that failure: counted, it would use up the
  attempts before one was made that could have worked.

The budget limits both cases, so a dependency that flaps does not cause more actions than the budget allows.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

from phm.core.backoff import pause_s
from phm.core.model import Fault
from phm.core.settings import RecoverySettings

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
    """It does not count as a failure of the target."""
    partly: bool = False
    """The unit itself recovered, but not everything that needs it."""


@dataclass(slots=True)
class History:
    """Attempts on one target, newest last, capped. The list is replaced and never changed: any thread may read it."""

    attempts: list[AttemptRecord] = field(default_factory=list)

    def add(self, attempt: AttemptRecord) -> None:
        self.attempts = [*self.attempts, attempt][-KEPT:]

    def within(self, since: float) -> list[AttemptRecord]:
        """Attempts that began at `since` (monotonic seconds) or later."""
        return [attempt for attempt in self.attempts if attempt.at >= since]

    def reset_backoff(self, units: Collection[str], down_from: float) -> frozenset[str]:
        """Something that `units` need has recovered, after it was down from `down_from` (monotonic seconds).

        Returns the units with an attempt that no longer counts.
        """
        not_counted = {each.unit for each in self.attempts if each.unit in units and each.at >= down_from}
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=each.not_counted or each.at >= down_from)
            if each.unit in units
            else each
            for each in self.attempts
        ]
        return frozenset(not_counted)

    def discount_before(self, since: float) -> bool:
        """A new generation of the container began at `since` (monotonic seconds); whether an attempt counts no longer."""
        old = [each for each in self.attempts if each.at < since and not (each.backoff_reset and each.not_counted)]
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=True) if each.at < since else each for each in self.attempts
        ]
        return bool(old)


@dataclass(frozen=True, slots=True)
class Failures:
    """What `history` says about an attempt for `fault` at `now` (monotonic seconds).

    lasting_s: a recovery that lasted for less does not count: a container that starts and exits again is failing.

    A longer time in which the unit was OK, e.g. because an operator repaired it, resets the counts. Attempts with
    `not_counted` are neither a success nor a failure.
    """

    history: History
    fault: Fault
    now: float
    lasting_s: float

    def of_the_unit(self) -> list[AttemptRecord]:
        """Attempts for the same unit and condition that did not help, since the last one that did."""
        return self._failed([attempt for attempt in self._counted() if self._own(attempt)])

    def of_the_action(self, action: str) -> list[AttemptRecord]:
        """Executions of `action`, for any fault of the target, that did not help, since the last one that did.

        An execution that helped another fault and did not last counts for that fault only.
        """
        return self._failed([attempt for attempt in self._counted() if attempt.action == action])

    def ready_at(self, settings: RecoverySettings, elsewhere: Sequence[AttemptRecord] = ()) -> float:
        """Back-off: the first attempt immediately, then 1, 2, 4 ... seconds after the last, whether it helped or not.

        What helped and failed again so soon counts too, or a flapping container would be restarted without pause; an
        attempt with `backoff_reset` does not. elsewhere: attempts for other faults of the container that count as well.
        """
        mine = [attempt for attempt in self._within() if self._own(attempt)]
        others = [attempt for attempt in elsewhere if attempt not in mine]
        same = sorted((each for each in (*mine, *others) if not each.backoff_reset), key=lambda attempt: attempt.at)
        if not same:
            return self.now
        return same[-1].at + pause_s(len(same), settings.backoff, settings.backoff_max)

    def _within(self) -> list[AttemptRecord]:
        return self.history.within(self.now - CLEAN_S)

    def _counted(self) -> list[AttemptRecord]:
        """Newest first, without those before a long time in which the unit was OK."""
        since = self.fault.opened.mono if self.fault.ok_s > self.lasting_s else float("-inf")
        return [attempt for attempt in reversed(self._within()) if attempt.at >= since]

    def _own(self, attempt: AttemptRecord) -> bool:
        return (attempt.unit, attempt.condition) == (self.fault.unit, self.fault.result.condition)

    def _failed(self, newest_first: Sequence[AttemptRecord]) -> list[AttemptRecord]:
        failures: list[AttemptRecord] = []
        broke_again = self.fault.opened.mono
        for attempt in newest_first:
            if attempt.worked and broke_again - attempt.at > self.lasting_s:
                break
            if attempt.not_counted or (attempt.worked and not self._own(attempt)):
                continue
            failures.append(attempt)
            broke_again = attempt.at
        return failures
