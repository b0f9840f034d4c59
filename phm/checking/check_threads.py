"""The threads that run the checks. Normally one runs them all, one after the other.

On a small computer most of the cost of a short check is waking a thread, and code and data that are no longer in the CPU's caches.
But a check may wait, for the Docker Engine or a device, and must not delay the others. So one thread, the leader, looks for the
next turn. Before a run that may take long, or while one does, it hands over: another thread leads from then on. This is the
pattern leader/followers (Schmidt et al., Pattern-Oriented Software Architecture 2); Go's scheduler does the same for a thread in
a system call.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable, Sequence

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
    """One thread for each check, nearly all of which only wait: when they are needed, the system may have no room for another.

    Invariant: only the leader takes a check, and no two threads run the same.
    """

    def __init__(self, turns: Sequence[CheckTurns], clock: Clock) -> None:
        self._turns, self._clock = tuple(turns), clock
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._ending = False
        self._careful_until = clock.mono()
        self._urgent: deque[CheckTurns] = deque()
        """Checks that were woken by an event and have not run since, each once."""
        self._looking_since: float | None = None
        """Since when there have been due checks, for one leader after the other."""
        self._position = 0
        """The next check to look at. Only the leader changes it."""
        self._workers = [_Worker(self, number) for number, _ in enumerate(turns, 1)]
        self._idle: list[_Worker] = []
        self._leader: _Worker | None = None

    def start(self) -> None:
        for each in self._workers:
            threads.start(each.thread)

    def wake(self, woken: Iterable[CheckTurns], reason: str, *, urgent: bool) -> None:
        """Run these as soon as possible. urgent: before the others."""
        with self._lock:
            for each in woken:
                each.wake(reason)
                if urgent:
                    self._put_first(each)
        self._wake.set()
        self.relieve(self._clock.mono())

    def relieve(self, now: float) -> float:
        """Have another thread lead while a run of the leader takes long. Return the seconds until it may be needed again."""
        with self._lock:
            leader = self._leader
            if self._ending or leader is None:
                return float("inf")
            if not leader.ended:
                if leader.current is None or leader.current.taken_at is None:
                    return float("inf")
                left_s = leader.current.taken_at + LONG_S - now
                if left_s > 0:
                    return left_s
            if any(each.taken_at is None and each.due <= now for each in self._turns):
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
        self._wake.set()
        for each in self._workers:
            each.promoted.set()

    def join(self, until: float) -> None:
        """Wait for their end, until this moment (monotonic seconds)."""
        for each in self._workers:
            threads.join(each.thread, max(0.01, until - self._clock.mono()))

    # ------------------------------------------------------------ in the threads

    def work(self, me: _Worker) -> None:
        """The loop of one thread."""
        while not self._ending:
            if not self._leads(me):
                me.promoted.wait()
                me.promoted.clear()
                continue
            self._wake.clear()
            if self._run_due(me):
                now, self._looking_since = self._clock.mono(), None
                self._clock.wait(self._wake, min(each.next_look(now) for each in self._turns) - now)

    def _leads(self, me: _Worker) -> bool:
        """Whether it leads: the first one does. If not, it is free for another time."""
        with self._lock:
            if self._leader is None:
                self._leader = me
            if self._leader is me or self._ending:
                return not self._ending
            self._idle.append(me)
            return False

    def _run_due(self, me: _Worker) -> bool:
        """Look at each check once. Return whether this thread still leads."""
        looked_at = self._clock.mono()
        self._looking_since = self._looking_since or looked_at
        for _ in self._turns:
            if not self._run_urgent(me, looked_at):
                return False
            each = self._turns[self._position]
            self._position = (self._position + 1) % len(self._turns)
            if not self._run_if_due(me, each, looked_at):
                return False
            if (now := self._clock.mono()) - looked_at >= LONG_S:
                looked_at = now
        return True

    def _run_urgent(self, me: _Worker, looked_at: float) -> bool:
        """Return whether it still leads."""
        for _ in range(len(self._urgent)):
            with self._lock:
                each = self._urgent.popleft()
                pauses = each.woken and each.due > self._clock.mono() + SAME_S
                if pauses:  # it has just run
                    self._put_first(each)
            if not pauses and not self._run_if_due(me, each, looked_at):
                return False
        return True

    def _run_if_due(self, me: _Worker, turns: CheckTurns, looked_at: float) -> bool:
        """Return whether it still leads."""
        now = self._clock.mono()
        with self._lock:
            if self._ending or self._leader is not me:
                return False
            if turns.taken_at is not None or turns.due > now + SAME_S:
                return True
            turns.taken_at, me.current = now, turns
            if self._others_would_wait(now) or turns.may_take_long(now):
                self._hand_over()
        turns.run(looked_at)
        with self._lock:
            turns.taken_at = me.current = None
            if self._leader is me:
                return True
            if turns.woken:  # meanwhile, and the leader could not take it
                self._put_first(turns)
                self._wake.set()
        return False

    def _others_would_wait(self, now: float) -> bool:
        """Whether those that are due have been waiting for others for long."""
        return now < self._careful_until or now - (self._looking_since or now) >= LONG_S

    # ------------------------------------------------------------ with the lock held

    def _put_first(self, turns: CheckTurns) -> None:
        if turns not in self._urgent:
            self._urgent.append(turns)

    def _hand_over(self) -> None:
        """Another thread leads from now on. Without one, while the system has no room for all threads, the current one still does."""
        if self._idle:
            self._leader = self._idle.pop()
            self._leader.promoted.set()
