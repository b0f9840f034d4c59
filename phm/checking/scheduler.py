"""Run checks, each in its own thread: immediately, after each period, and when woken.

Modelled on kubelet's prober. A check that raises or hangs makes only its own units STALE: that is a statement about PHM, never
a fault of the vehicle. The scheduler does not evaluate levels.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phm.api import CannotTell, Check, World, stale
from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Level, Result

logger = logging.getLogger(__name__)

MIN_GAP_S = 0.05
"""Minimum pause between two runs of a check, however often it is woken."""
_MISSING = stale("the check returned no result for this unit")
WATCH_S = 0.1
"""How often `tick` runs while a unit settles; part of the time to detect a dead node."""


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


class CheckThread:
    """The thread of one check. `running_since` is None between runs."""

    def __init__(self, scheduled: ScheduledCheck, world: World, clock: Clock, sink: Sink, offset: float = 0.0) -> None:
        """offset: share of its period by which its turns are later than those of others. Threads that wake together wait for each
        other, which costs each a second wake-up."""
        self.scheduled = scheduled
        self._first = clock.mono() + offset * scheduled.period_s
        self.units = scheduled.units
        self._world, self._clock, self._sink = world, clock, sink
        self._wake = threading.Event()
        self._reason = "start"
        self._stopping = False
        self.running_since: float | None = None
        self.overdue_reported = False
        self._thread = threading.Thread(target=self._loop, name=f"phm-check-{self.units[0]}", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def wake(self, reason: str) -> None:
        self._reason = reason
        self._wake.set()

    def stop(self) -> None:
        self._stopping = True
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        threads.join(self._thread, timeout_s)

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

    def _loop(self) -> None:
        while not self._stopping:
            reason, self._reason = self._reason, "period"
            self._wake.clear()
            started = self._clock.mono()
            self._run(reason)
            ended = self._clock.mono()
            self._clock.wait(self._wake, self._pause_s(started, ended))
            # Only after an early wake-up, so that an idle check costs one wait per run.
            if (left_s := ended + MIN_GAP_S - self._clock.mono()) > 0:
                self._clock.wait(threading.Event(), left_s)

    def _pause_s(self, started: float, ended: float) -> float:
        """Until its next turn, at most a period; as long as the run took, so that a slow check does not run all the time."""
        period_s = max(MIN_GAP_S, self.scheduled.period_s)
        return max(MIN_GAP_S, min(period_s, ended - started), period_s - (ended - self._first) % period_s)

    def _run(self, reason: str) -> None:
        started = self._clock.mono()
        self.overdue_reported = False
        self.running_since = started
        try:
            results = self._evaluate()
        finally:
            self.running_since = None
        if not self._stopping:
            self._deliver(CheckRun(results, started, self._clock.mono() - started, reason))

    def _deliver(self, run: CheckRun) -> None:
        try:
            self._sink(run)
        except Exception:  # a defect in the sink must not end this thread: its units would never be checked again
            logger.exception("results of check %s were lost", self.units[0])

    def _evaluate(self) -> dict[str, Result]:
        try:
            answer: Any = self.scheduled.check.run(self._world)
            answers = answer if isinstance(answer, Mapping) else self._all(answer)
            return {unit: _checked(answers.get(unit, _MISSING)) for unit in self.units}
        except CannotTell as error:
            return self._all(stale(str(error)))
        except BaseException as error:  # a plug-in may raise anything, SystemExit included: PHM goes on
            logger.exception("check %s crashed", self.units[0])
            return self._all(stale(f"the check crashed: {type(error).__name__}: {error}"))

    def _all(self, result: Any) -> dict[str, Any]:
        return dict.fromkeys(self.units, result)


def _checked(answer: Any) -> Result:
    """What a check returned for one unit. A plug-in may return anything; only a result with a level may go further."""
    if isinstance(answer, Result) and isinstance(answer.level, Level):
        words = (answer.summary, answer.brief, answer.condition, answer.target)
        if all(isinstance(text, str) for text in words):
            return answer
    return stale(f"the check returned {type(answer).__name__}, not a Result with a level and texts")


class CheckScheduler:
    """All check threads and their deadlines. `sink` is called from check threads and must be fast."""

    def __init__(self, scheduled: Sequence[ScheduledCheck], world: World, clock: Clock, sink: Sink) -> None:
        self._clock, self._sink = clock, sink
        self.threads = [
            CheckThread(entry, world, clock, sink, number / len(scheduled)) for number, entry in enumerate(scheduled)
        ]
        self._by_unit = {unit: thread for thread in self.threads for unit in thread.units}
        self._by_subject: dict[str, list[CheckThread]] = {}
        for thread in self.threads:
            for subject in thread.scheduled.check.wakes:
                self._by_subject.setdefault(subject, []).append(thread)

    def start(self) -> None:
        for thread in self.threads:
            thread.start()

    def wake_subject(self, subject: str, reason: str = "") -> None:
        """Wake every check that named `subject` in its `wakes`."""
        for thread in self._by_subject.get(subject, ()):
            thread.wake(reason or subject)

    def wake_units(self, units: Iterable[str], reason: str) -> None:
        for thread in {id(thread): thread for unit in units if (thread := self._by_unit.get(unit))}.values():
            thread.wake(reason)

    def report_overdue(self) -> float:
        """Report runs past their deadline as STALE, once each. Return the seconds until the next current run is overdue."""
        now, next_s = self._clock.mono(), float("inf")
        for thread in self.threads:
            since = thread.running_since
            if since is None or thread.overdue_reported:
                continue
            left_s, limit = thread.left_s(now), thread.scheduled.deadline_s
            if left_s is None or left_s >= 0:
                next_s = min(next_s, next_s if left_s is None else left_s)
                continue
            thread.overdue_reported = True
            result = stale(f"the check exceeded its deadline of {limit:g} s; it is still running")
            self._sink(CheckRun(dict.fromkeys(thread.units, result), now, now - since, "overdue", overdue=True))
        return next_s

    def overdue(self) -> tuple[str, ...]:
        """First unit of each check that is past its deadline now."""
        now = self._clock.mono()
        return tuple(thread.units[0] for thread in self.threads if thread.overdue(now))

    def end(self) -> None:
        """Ask all threads to end, without waiting. Results of current runs are discarded."""
        for thread in self.threads:
            thread.stop()

    def stop(self, timeout_s: float = 2.0) -> None:
        """`end`, and wait for all threads. A thread that hangs ends with the process (they are daemon threads)."""
        self.end()
        until = self._clock.mono() + timeout_s
        for thread in self.threads:
            thread.join(max(0.01, until - self._clock.mono()))
