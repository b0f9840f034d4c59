"""Run checks: at the start, each period, and when woken, each with a deadline.

Modelled on kubelet's prober. A check that raises or hangs makes only its own units STALE: that is a statement about PHM, never
a fault of the vehicle. The scheduler does not evaluate levels.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from phm.api import World, stale
from phm.checking.check_threads import CheckThreads
from phm.checking.check_turns import FOR_REPORT, CheckRun, CheckTurns, ScheduledCheck, Sink
from phm.core.clock import Clock

WATCH_S = 0.1
"""How often `tick` runs while a unit settles; part of the time to detect a dead node."""


class CheckScheduler:
    """All checks and their deadlines. `sink` is called from the threads of the checks and must be fast."""

    def __init__(self, scheduled: Sequence[ScheduledCheck], world: World, clock: Clock, sink: Sink) -> None:
        self._clock, self._sink = clock, sink
        now = clock.mono()
        self.turns = [CheckTurns(entry, world, clock, sink, now) for entry in scheduled]
        self._threads = CheckThreads(self.turns, clock)
        self._by_unit = {unit: each for each in self.turns for unit in each.units}
        self._by_subject: dict[str, list[CheckTurns]] = {}
        for each in self.turns:
            for subject in each.scheduled.check.wakes:
                self._by_subject.setdefault(subject, []).append(each)

    def start(self) -> None:
        for each in self.turns:
            each.start()
        self._threads.start()

    def wake_subject(self, subject: str, reason: str = "") -> None:
        """Wake every check that named `subject` in its `wakes`."""
        self._wake(self._by_subject.get(subject, ()), reason or subject)

    def wake_units(self, units: Iterable[str], reason: str) -> None:
        """Wake the checks of these units. They run before those that only their period or a report (FOR_REPORT) makes due."""
        self._wake({id(each): each for unit in units if (each := self._by_unit.get(unit))}.values(), reason)

    def _wake(self, woken: Collection[CheckTurns], reason: str) -> None:
        self._threads.wake(woken, reason, urgent=reason != FOR_REPORT)

    def report_overdue(self) -> float:
        """Report checks past their deadline as STALE, once for each run, and continue with the others while one takes long.

        Return the seconds until the next current run is overdue or takes long.
        """
        now = self._clock.mono()
        next_s = self._threads.relieve(now)
        for each in self.turns:
            running, since = owed = each.owed
            if since > now or each.overdue_reported == owed:
                continue
            left_s = each.left_s(now)
            if left_s >= 0:
                next_s = min(next_s, left_s)
                continue
            each.overdue_reported = owed
            limit = f"{each.scheduled.deadline_s:g} s"
            late = (
                f"exceeded its deadline of {limit}; it is still running"
                if running
                else f"has waited {limit} for a thread"
            )
            result = stale(f"the check {late}")
            begun = now if running else since  # the run for which it waits counts from later
            self._sink(CheckRun(dict.fromkeys(each.units, result), begun, now - since, "overdue", overdue=True))
        return next_s

    def overdue(self) -> tuple[str, ...]:
        """First unit of each check that is past its deadline now, or whose thread has ended."""
        now = self._clock.mono()
        ended = {id(each) for each in self._threads.ended()}
        return tuple(each.units[0] for each in self.turns if each.overdue(now) or id(each) in ended)

    def end(self) -> None:
        """Ask all threads to end, without waiting. Results of current runs are discarded."""
        for each in self.turns:
            each.stopping = True
        self._threads.end()

    def stop(self, timeout_s: float = 2.0) -> None:
        """`end`, and wait for all threads. A thread that hangs ends with the process (they are daemon threads)."""
        self.end()
        self._threads.join(self._clock.mono() + timeout_s)
