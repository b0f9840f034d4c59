"""Runs checks: one worker thread each, now and then whenever its period ends or somebody wakes it.

The shape is kubelet's prober. A check that raises or hangs makes only its own units STALE: the result
is a statement about PHM, never a fault of the vehicle. The engine neither judges nor remembers levels.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm.api import CannotTell, Check, World, stale
from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Result

logger = logging.getLogger(__name__)

MIN_GAP_S = 0.05
"""A check that is woken all the time still leaves the processor alone this long between runs."""
WATCH_S = 0.1
"""How often settling is judged while something settles; part of the time to detect a dead node."""


@dataclass(frozen=True, slots=True)
class ScheduledCheck:
    """One check instance with what the configuration says about its running."""

    check: Check
    period_s: float
    deadline_s: float

    @property
    def units(self) -> tuple[str, ...]:
        return tuple(unit.id for unit in self.check.units)


@dataclass(frozen=True, slots=True)
class CheckRun:
    """What one run gave: a result for every unit of the check. `started` is monotonic seconds."""

    units: Mapping[str, Result]
    started: float
    duration_s: float
    reason: str
    overdue: bool = False


Sink = Callable[[CheckRun], None]


class CheckThread:
    """The thread of one check. `running_since` is None between runs; the watchdog reads it."""

    def __init__(self, scheduled: ScheduledCheck, world: World, clock: Clock, sink: Sink) -> None:
        self.scheduled = scheduled
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
        """Until the deadline of the run under way, in which time does not count while PHM does not run; None: nothing runs."""
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
            self._run(reason)
            ended = self._clock.mono()
            self._clock.wait(self._wake, max(MIN_GAP_S, self.scheduled.period_s))
            # Only after an early wake: a wait is what an idle check costs, so the usual run has one.
            if (left_s := ended + MIN_GAP_S - self._clock.mono()) > 0:
                self._clock.wait(threading.Event(), left_s)

    def _run(self, reason: str) -> None:
        started = self._clock.mono()
        self.overdue_reported = False
        self.running_since = started
        try:
            results = self._judge()
        finally:
            self.running_since = None
        if not self._stopping:
            self._deliver(CheckRun(results, started, self._clock.mono() - started, reason))

    def _deliver(self, batch: CheckRun) -> None:
        try:
            self._sink(batch)
        except Exception:  # a defect behind the sink: without this thread its units would never be looked at again
            logger.exception("the results of %s were lost", self.units[0])

    def _judge(self) -> dict[str, Result]:
        try:
            answer = self.scheduled.check.run(self._world)
        except CannotTell as error:
            return self._all(stale(str(error)))
        except BaseException as error:  # a plug-in may raise anything, SystemExit included: PHM goes on
            logger.exception("check %s crashed", self.units[0])
            return self._all(stale(f"the check itself crashed: {type(error).__name__}: {error}"))
        if isinstance(answer, Result):
            return self._all(answer)
        missing = stale("the check said nothing about this unit")
        return {unit: answer.get(unit, missing) for unit in self.units}

    def _all(self, result: Result) -> dict[str, Result]:
        return dict.fromkeys(self.units, result)


class CheckScheduler:
    """All workers and the watchdog over them. `sink` is called from worker threads and must be quick."""

    def __init__(self, scheduled: Sequence[ScheduledCheck], world: World, clock: Clock, sink: Sink) -> None:
        self._clock, self._sink = clock, sink
        self.workers = [CheckThread(entry, world, clock, sink) for entry in scheduled]
        self._by_unit = {unit: worker for worker in self.workers for unit in worker.units}
        self._by_subject: dict[str, list[CheckThread]] = {}
        for worker in self.workers:
            for subject in worker.scheduled.check.wakes:
                self._by_subject.setdefault(subject, []).append(worker)

    def start(self) -> None:
        for worker in self.workers:
            worker.start()

    def wake_subject(self, subject: str, reason: str = "") -> None:
        """Wake every check that named `subject` in its `wakes`."""
        for worker in self._by_subject.get(subject, ()):
            worker.wake(reason or subject)

    def wake_units(self, units: Iterable[str], reason: str) -> None:
        for worker in {id(worker): worker for unit in units if (worker := self._by_unit.get(unit))}.values():
            worker.wake(reason)

    def wake_all(self, reason: str) -> None:
        for worker in self.workers:
            worker.wake(reason)

    def look_for_overdue(self) -> float:
        """Report runs that have passed their deadline, once each, as STALE. Returns how long none of those that run now will be."""
        now, calm_s = self._clock.mono(), float("inf")
        for worker in self.workers:
            since = worker.running_since
            if since is None or worker.overdue_reported:
                continue
            left_s, limit = worker.left_s(now), worker.scheduled.deadline_s
            if left_s is None or left_s >= 0:
                calm_s = min(calm_s, calm_s if left_s is None else left_s)
                continue
            worker.overdue_reported = True
            result = stale(f"the check has not come back within its deadline of {limit:g} s; it is left running")
            self._sink(CheckRun(dict.fromkeys(worker.units, result), now, now - since, "overdue", overdue=True))
        return calm_s

    def overdue(self) -> tuple[str, ...]:
        """First unit of each check that is past its deadline now."""
        now = self._clock.mono()
        return tuple(worker.units[0] for worker in self.workers if worker.overdue(now))

    def end(self) -> None:
        """Have all threads end; what a run gives from now on is not delivered. Waits for nothing."""
        for worker in self.workers:
            worker.stop()

    def stop(self, timeout_s: float = 2.0) -> None:
        """`end`, and wait for all together; one that hangs is left to the process's end (they are daemon threads)."""
        self.end()
        until = self._clock.mono() + timeout_s
        for worker in self.workers:
            worker.join(max(0.01, until - self._clock.mono()))
