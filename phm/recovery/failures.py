"""Which attempts count against the next one: those that did not help a unit, and those that did not help the container. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phm.core.backoff import pause_s
from phm.core.model import Fault
from phm.core.settings import RecoverySettings
from phm.recovery.history import CLEAN_S, AttemptRecord, History


@dataclass(frozen=True, slots=True)
class Failures:
    """What `history` says about an attempt for `fault` at `now` (monotonic seconds).

    lasting_s: help that lasted for less was none: a container that starts and dies again counts as failing.

    Whatever has made the unit OK for longer, an operator after PHM gave up, starts the counts again. Excused attempts are
    neither a success nor a failure.
    """

    history: History
    fault: Fault
    now: float
    lasting_s: float

    def of_the_unit(self) -> list[AttemptRecord]:
        """Attempts for the same unit and condition that did not help, since the last one that did or a clean time."""
        return self._failed([attempt for attempt in self._counted() if self._own(attempt)])

    def of_the_action(self, action: str) -> list[AttemptRecord]:
        """Executions of `action`, for whichever fault of the container, that did not help, since the last one that did.

        An execution that helped another fault and did not last is that fault's own trouble, and is not counted here.
        """
        return self._failed([attempt for attempt in self._counted() if attempt.action == action])

    def ready_at(self, settings: RecoverySettings, elsewhere: Sequence[AttemptRecord] = ()) -> float:
        """Back-off: the first attempt at once, then 1, 2, 4 ... seconds after the last, whether it helped or not.

        What helped and broke again so soon counts too, or a flapping container would be restarted without pause; what was
        eased since does not. `elsewhere`: attempts for other faults of the container that count as well.
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
        """Newest first, without what was before a time in which the unit was OK for long."""
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
