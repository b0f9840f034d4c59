"""Run checks in threads: one for each check that may wait for something, and one for all those that only evaluate what PHM knows.

Modelled on kubelet's prober. A check that raises or hangs makes only its own units STALE: that is a statement about PHM, never
a fault of the vehicle. The scheduler does not evaluate levels.

On a small computer most of the cost of a short check is that of code and data that are no longer in the CPU's caches. So checks of
one period run shortly after each other.
"""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence

from phm.api import World, stale
from phm.checking.check_turns import CheckRun, CheckTurns, ScheduledCheck, Sink
from phm.core import threads
from phm.core.clock import Clock

WATCH_S = 0.1
"""How often `tick` runs while a unit settles; part of the time to detect a dead node."""
APART_S = 0.003
"""Between the turns of two threads: threads that wake together wait for each other, which costs each a second wake-up."""
SAME_S = 0.001
"""Turns of one thread that are closer together are one turn."""


class CheckThread:
    """The thread of one check, or of several that never wait: the first of them gives it its name."""

    def __init__(self, turns: Sequence[CheckTurns], clock: Clock) -> None:
        self._turns, self._clock = tuple(turns), clock
        self._current: CheckTurns | None = None
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stopping = False
        for each in self._turns:
            each.thread_wake = self._wake
        self._thread = threading.Thread(target=self._loop, name=f"phm-check-{turns[0].units[0]}", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def stop(self) -> None:
        self._stopping = True
        for each in self._turns:
            each.stopping = True
        self._wake.set()

    def join(self, timeout_s: float) -> None:
        threads.join(self._thread, timeout_s)

    @property
    def ended(self) -> tuple[CheckTurns, ...]:
        """Its checks, if the thread has ended although it should run."""
        thread = self._thread
        return () if thread.ident is None or thread.is_alive() or self._stopping else self._turns

    def without_hung(self) -> CheckThread | None:
        """A new thread, not started, for the other checks of this one, while the current one is past its deadline. None: not needed."""
        with self._lock:
            hung = self._current
            if hung is None or len(self._turns) == 1 or not hung.overdue(self._clock.mono()):
                return None
            others = [each for each in self._turns if each is not hung]
            self._turns = (hung,)
        return CheckThread(others, self._clock)

    def _loop(self) -> None:
        while not self._stopping:
            self._wake.clear()
            now = self._clock.mono()
            for each in self._turns:
                if each.due <= now + SAME_S and self._claim(each):
                    each.run()
            self._claim(None)
            self._clock.wait(self._wake, min(each.due for each in self._turns) - self._clock.mono())

    def _claim(self, turns: CheckTurns | None) -> bool:
        """Whether this thread may run it: `without_hung` may have moved it to another thread meanwhile."""
        with self._lock:
            mine = not self._stopping and (turns is None or turns in self._turns)
            self._current = turns if mine else None
        return mine


class CheckScheduler:
    """All check threads and their deadlines. `sink` is called from check threads and must be fast."""

    def __init__(self, scheduled: Sequence[ScheduledCheck], world: World, clock: Clock, sink: Sink) -> None:
        self._clock, self._sink = clock, sink
        now = clock.mono()
        quick = [CheckTurns(entry, world, clock, sink, now) for entry in scheduled if not entry.check.blocking]
        slow = [entry for entry in scheduled if entry.check.blocking]
        own = [CheckTurns(entry, world, clock, sink, now + (n + 1) * APART_S) for n, entry in enumerate(slow)]
        self.turns = [*quick, *own]
        self._threads = [CheckThread(group, clock) for group in (quick, *([each] for each in own)) if group]
        self._ending = False
        self._lock = threading.Lock()
        self._by_unit = {unit: each for each in self.turns for unit in each.units}
        self._by_subject: dict[str, list[CheckTurns]] = {}
        for each in self.turns:
            for subject in each.scheduled.check.wakes:
                self._by_subject.setdefault(subject, []).append(each)

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def wake_subject(self, subject: str, reason: str = "") -> None:
        """Wake every check that named `subject` in its `wakes`."""
        for each in self._by_subject.get(subject, ()):
            each.wake(reason or subject)

    def wake_units(self, units: Iterable[str], reason: str) -> None:
        for each in {id(each): each for unit in units if (each := self._by_unit.get(unit))}.values():
            each.wake(reason)

    def report_overdue(self) -> float:
        """Report runs past their deadline as STALE, once each. Return the seconds until the next current run is overdue."""
        now, next_s = self._clock.mono(), float("inf")
        for each in self.turns:
            since = each.running_since
            if since is None or each.overdue_reported:
                continue
            left_s, limit = each.left_s(now), each.scheduled.deadline_s
            if left_s is None or left_s >= 0:
                next_s = min(next_s, next_s if left_s is None else left_s)
                continue
            each.overdue_reported = True
            result = stale(f"the check exceeded its deadline of {limit:g} s; it is still running")
            self._sink(CheckRun(dict.fromkeys(each.units, result), now, now - since, "overdue", overdue=True))
            self._free_others()
        return next_s

    def overdue(self) -> tuple[str, ...]:
        """First unit of each check that is past its deadline now, or whose thread has ended."""
        now = self._clock.mono()
        ended = {id(each) for thread in self._threads for each in thread.ended}
        return tuple(each.units[0] for each in self.turns if each.overdue(now) or id(each) in ended)

    def end(self) -> None:
        """Ask all threads to end, without waiting. Results of current runs are discarded."""
        with self._lock:
            self._ending = True
            for thread in self._threads:
                thread.stop()

    def stop(self, timeout_s: float = 2.0) -> None:
        """`end`, and wait for all threads. A thread that hangs ends with the process (they are daemon threads)."""
        self.end()
        until = self._clock.mono() + timeout_s
        for thread in self._threads:
            thread.join(max(0.01, until - self._clock.mono()))

    def _free_others(self) -> None:
        """A check that hangs although it should never wait keeps its thread; the others of that thread get another one."""
        with self._lock:
            for thread in self._threads:
                if not self._ending and (others := thread.without_hung()) is not None:
                    self._threads = [*self._threads, others]
                    others.start()
