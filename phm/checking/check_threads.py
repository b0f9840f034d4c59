"""The threads that run the checks. Normally one runs them all, one after the other.

On a small computer most of the cost of a short check is waking a thread, and code and data that are no longer in the CPU's caches.
But a check may wait, for the Docker Engine or a device, and must not delay the others. So one thread, the leader, looks for the
next turn. Before a run that may take long, or while one does, it hands over: another thread leads from then on. This is the
pattern leader/followers (Schmidt et al., Pattern-Oriented Software Architecture 2); Go's scheduler does the same for a thread in
a system call.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

from phm.checking.check_turns import LONG_S, CheckTurns
from phm.core import threads
from phm.core.clock import Clock

SAME_S = 0.001
"""Turns that are closer together are one turn."""
CAREFUL_S = 1.0
"""How long, after a run that took long unexpectedly, every run gets another thread beside it. What one check waits for, e.g. an
engine that hangs, others will wait for as well."""


class _Worker:
    """One thread. `current`: the check that it runs."""

    def __init__(self, owner: CheckThreads, number: int) -> None:
        self.promoted = threading.Event()
        self.current: CheckTurns | None = None
        self.thread = threading.Thread(target=owner.work, args=(self,), name=f"phm-check-{number}", daemon=True)

    @property
    def ended(self) -> bool:
        return self.thread.ident is not None and not self.thread.is_alive()


class CheckThreads:
    """At most one thread for each check; a thread that was needed once waits for the next time.

    Invariant: only the leader takes a check, and no two threads run the same.
    """

    def __init__(self, turns: Sequence[CheckTurns], clock: Clock) -> None:
        self._turns, self._clock = tuple(turns), clock
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._ending = False
        self._careful_until = clock.mono()
        self._workers: list[_Worker] = []
        self._idle: list[_Worker] = []
        self._leader = self._add()

    def start(self) -> None:
        self._leader.promoted.set()
        threads.start(self._leader.thread)

    def wake(self) -> None:
        """A check has been woken."""
        self._wake.set()
        self.relieve(self._clock.mono())

    def relieve(self, now: float) -> float:
        """Have another thread lead while a run of the leader takes long. Return the seconds until it may be needed again."""
        with self._lock:
            current = self._leader.current
            if self._ending or not (current or self._leader.ended):
                return float("inf")
            since = current.taken_at if current else None
            left_s = LONG_S if since is None else since + LONG_S - now
            if left_s > 0 and not self._leader.ended:
                return left_s
            if not any(each.taken_at is None and each.due <= now for each in self._turns):
                return LONG_S
            self._careful_until = now + CAREFUL_S
            self._hand_over()
            return LONG_S

    def ended(self) -> tuple[CheckTurns, ...]:
        """The checks whose thread has ended although it should run."""
        with self._lock:
            return tuple(each.current for each in self._workers if each.current is not None and each.ended)

    def end(self) -> None:
        """Ask all threads to end, without waiting."""
        with self._lock:
            self._ending = True
            workers = list(self._workers)
        self._wake.set()
        for each in workers:
            each.promoted.set()

    def join(self, until: float) -> None:
        """Wait for their end, until this moment (monotonic seconds)."""
        for each in list(self._workers):
            threads.join(each.thread, max(0.01, until - self._clock.mono()))

    # ------------------------------------------------------------ in the threads

    def work(self, me: _Worker) -> None:
        """The loop of one thread."""
        while not self._ending:
            me.promoted.wait()
            me.promoted.clear()
            while self._leads(me):
                self._wake.clear()
                looked_at = self._clock.mono()
                if all(self._run_if_due(me, each, looked_at) for each in self._turns):
                    now = self._clock.mono()
                    self._clock.wait(self._wake, min(each.next_look(now) for each in self._turns) - now)

    def _leads(self, me: _Worker) -> bool:
        """Whether it still leads. If not, it is free for another time."""
        with self._lock:
            if self._leader is me or self._ending:
                return not self._ending
            self._idle.append(me)
            return False

    def _run_if_due(self, me: _Worker, turns: CheckTurns, looked_at: float) -> bool:
        """Return whether it still leads."""
        now = self._clock.mono()
        if turns.due > now + SAME_S:
            return True
        with self._lock:
            if self._ending or self._leader is not me:
                return False
            if turns.taken_at is not None:
                return True
            turns.taken_at, me.current = now, turns
            if now < self._careful_until or turns.may_take_long(now):
                self._hand_over()
        turns.run(looked_at)
        with self._lock:
            turns.taken_at = me.current = None
            if self._leader is me:
                return True
        if turns.woken:  # meanwhile, and the leader could not take it
            self._wake.set()
        return False

    # ------------------------------------------------------------ with the lock held

    def _hand_over(self) -> None:
        """Another thread leads from now on. Without one, at a process limit, the current one still does."""
        if self._idle:
            worker = self._idle.pop()
        else:
            worker = self._add()
            if not threads.start_now(worker.thread):
                self._workers.remove(worker)
                return
        self._leader = worker
        worker.promoted.set()

    def _add(self) -> _Worker:
        worker = _Worker(self, len(self._workers) + 1)
        self._workers.append(worker)
        return worker
