"""When one check runs, and its runs: immediately, after each period, and when woken. The caller has the thread."""

from __future__ import annotations

import logging
import math
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from phm.api import CannotTell, Check, World, stale
from phm.checking.result_check import checked
from phm.core import run_start
from phm.core.clock import Clock
from phm.core.model import Result

logger = logging.getLogger(__name__)

MIN_GAP_S = 0.05
"""Minimum pause between two runs of a check, however often it is woken."""
FOR_REPORT = "pass"
"""The reason of a wake-up of all checks for a report."""
LONG_S = 0.05
"""A run that takes longer may wait for something: the other checks get another thread."""
LONG_FOR_S = 60.0
"""How long after such a run the check gets a thread before it runs. An engine may leave only every second request unanswered."""
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
    """One run of a check: a result for each of its units. `started`: since when they count, in monotonic seconds."""

    units: Mapping[str, Result]
    started: float
    duration_s: float
    reason: str
    overdue: bool = False


Sink = Callable[[CheckRun], None]


class CheckTurns:
    """The turns of one check. `running_since` is None between runs. Only the thread that has taken it calls `run`."""

    def __init__(self, scheduled: ScheduledCheck, world: World, clock: Clock, sink: Sink, first: float) -> None:
        """first: the turns are at this moment (monotonic seconds) and multiples of the period after it."""
        self.scheduled, self.units = scheduled, scheduled.units
        self._world, self._clock, self._sink, self._first = world, clock, sink, first
        self._period_s = max(MIN_GAP_S, scheduled.period_s)
        self._reason = "start"
        self.woken = True
        self._woken_at = self._waits_since = self._next = self._long_until = clock.mono()
        self._rested = math.inf  # until `start`
        self.taken_at: float | None = None
        """Since when a thread runs it, with the delivery of its results; None: no thread does."""
        self.stopping = False
        self.running_since: float | None = None
        self.overdue_reported: tuple[bool, float] | None = None
        """The `owed` that was reported as overdue last."""

    def start(self) -> None:
        """It may run from now on."""
        self._rested = self._clock.mono()

    def wake(self, reason: str) -> None:
        """Run as soon as possible, once for all wake-ups until then. One caller at a time: `_woken_at` must not go back."""
        self._reason, self._woken_at = reason, self._clock.mono()
        if not self.woken:
            self._waits_since = self._woken_at
        self.woken = True

    @property
    def due(self) -> float:
        """The moment of the next run, in monotonic seconds, when it is not running."""
        return self._rested if self.woken else max(self._rested, self._next)

    def next_look(self, now: float) -> float:
        """When it may be due: while it is running, at its next turn."""
        return self.due if self.taken_at is None else now + self._left_s(now)

    def may_take_long(self, now: float) -> bool:
        """Whether a run of the last minute took long."""
        return now < self._long_until

    @property
    def owed(self) -> tuple[bool, float]:
        """Whether it runs, and since when it runs or waits for a thread (monotonic seconds): later than now if it does neither."""
        since = self.running_since
        if since is not None:
            return True, since
        if self.stopping or self.taken_at is not None:  # its results are being delivered
            return False, math.inf
        return False, max(self._rested, min(self._waits_since, self._next)) if self.woken else self.due

    def left_s(self, now: float) -> float:
        """Seconds to the deadline of its run or of its wait for a thread, without time in which PHM itself was suspended."""
        since, limit_s = self.owed[1], self.scheduled.deadline_s
        left_s = since + limit_s - now
        return left_s if left_s >= 0 else left_s + self._clock.late_s(since, limit_s)

    def overdue(self, now: float) -> bool:
        return self.left_s(now) < 0

    def run(self, looked_at: float) -> None:
        """Run the check and pass on its results. looked_at: when the thread looked for due checks, monotonic seconds. The results count
        from then, or from the wake-up if that was later: see `phm.core.run_start`."""
        self.woken = False  # before the reason is read: a wake-up from now on causes another run
        reason, self._reason = self._reason, "period"
        since = max(looked_at, self._woken_at)
        started = self._clock.mono()
        self.running_since = started
        try:
            with run_start.counting_from(since):
                results = self._evaluate()
        finally:
            self.running_since = None
        if not self.stopping:
            self._deliver(CheckRun(results, since, self._clock.mono() - started, reason))
        ended = self._clock.mono()
        self._next, self._rested = ended + self._pause_s(started, ended), ended + MIN_GAP_S
        if ended - started >= LONG_S:
            self._long_until = ended + LONG_FOR_S

    def _left_s(self, now: float) -> float:
        return self._period_s - (now - self._first) % self._period_s

    def _pause_s(self, started: float, ended: float) -> float:
        """Until its next turn, about a period at most; as long as the run took, so that a slow check does not run all the time."""
        left_s = self._left_s(ended)
        return max(left_s if left_s >= MIN_GAP_S else left_s + self._period_s, min(self._period_s, ended - started))

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
