"""When one check runs, and its runs: immediately, after each period, and when woken. The caller has the thread."""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from phm.api import CannotTell, Check, World, stale
from phm.checking.result_check import checked
from phm.core.clock import Clock
from phm.core.model import Result

logger = logging.getLogger(__name__)

MIN_GAP_S = 0.05
"""Minimum pause between two runs of a check, however often it is woken."""
_MISSING = stale("the check returned no result for this unit")


@dataclass(frozen=True, slots=True)
class ScheduledCheck:
    """One check instance with its period and deadline."""

    check: Check
    period_s: float
    deadline_s: float

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(unit.id for unit in self.check.units)


@dataclass(frozen=True, slots=True)
class CheckRun:
    """One run of a check: a result for each of its units. `started` is in monotonic seconds."""

    units: Mapping[str, Result]
    started: float
    duration_s: float
    reason: str
    overdue: bool = False


Sink = Callable[[CheckRun], None]


class CheckTurns:
    """The turns of one check. `running_since` is None between runs. Only the thread that runs it calls `run`."""

    def __init__(self, scheduled: ScheduledCheck, world: World, clock: Clock, sink: Sink, first: float) -> None:
        """first: the turns are at this moment (monotonic seconds) and multiples of the period after it."""
        self.scheduled, self.units = scheduled, scheduled.units
        self._world, self._clock, self._sink, self._first = world, clock, sink, first
        self._reason, self._woken = "start", True
        self._next = self._rested = clock.mono()
        self.thread_wake = threading.Event()
        """Wakes the thread that runs the check."""
        self.stopping = False
        self.running_since: float | None = None
        self.overdue_reported = False

    def wake(self, reason: str) -> None:
        """Run as soon as possible, once for all wake-ups until then."""
        self._reason = reason
        self._woken = True
        self.thread_wake.set()

    @property
    def due(self) -> float:
        """The moment of the next run, in monotonic seconds."""
        return self._rested if self._woken else max(self._rested, self._next)

    def left_s(self, now: float) -> float | None:
        """Seconds to the deadline of the current run, without time in which PHM itself was suspended; None: not running."""
        since, limit_s = self.running_since, self.scheduled.deadline_s
        if since is None:
            return None
        left_s = since + limit_s - now
        return left_s if left_s >= 0 else left_s + self._clock.late_s(since, limit_s)

    def overdue(self, now: float) -> bool:
        left_s = self.left_s(now)
        return left_s is not None and left_s < 0

    def run(self) -> None:
        """Run the check and pass on its results."""
        self._woken = False  # before the reason is read: a wake-up from now on causes another run
        reason, self._reason = self._reason, "period"
        started = self._clock.mono()
        self.overdue_reported = False
        self.running_since = started
        try:
            results = self._evaluate()
        finally:
            self.running_since = None
        if not self.stopping:
            self._deliver(CheckRun(results, started, self._clock.mono() - started, reason))
        ended = self._clock.mono()
        self._next, self._rested = ended + self._pause_s(started, ended), ended + MIN_GAP_S

    def _pause_s(self, started: float, ended: float) -> float:
        """Until its next turn, about a period at most; as long as the run took, so that a slow check does not run all the time."""
        period_s = max(MIN_GAP_S, self.scheduled.period_s)
        left_s = period_s - (ended - self._first) % period_s
        return max(left_s if left_s >= MIN_GAP_S else left_s + period_s, min(period_s, ended - started))

    def _deliver(self, run: CheckRun) -> None:
        try:
            self._sink(run)
        except Exception:  # a defect in the sink must not end the thread: its units would never be checked again
            logger.exception("results of check %s were lost", self.units[0])

    def _evaluate(self) -> dict[str, Result]:
        try:
            return self._results()
        except BaseException as error:  # a plug-in may raise anything, SystemExit included: PHM goes on
            logger.exception("check %s crashed", self.units[0])
            words = "".join(traceback.format_exception_only(error)).strip()  # also for one whose text cannot be made
            return self._all(stale(f"the check crashed: {words}"))

    def _results(self) -> dict[str, Result]:
        try:
            answer: Any = self.scheduled.check.run(self._world)
        except CannotTell as error:
            return self._all(stale(str(error)))
        answers = answer if isinstance(answer, Mapping) else self._all(answer)
        return {unit: checked(answers.get(unit, _MISSING)) for unit in self.units}

    def _all(self, result: Any) -> dict[str, Any]:
        return dict.fromkeys(self.units, result)
