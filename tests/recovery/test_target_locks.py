"""One attempt at a time on each target, and no deadlock."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any, cast

import pytest

from phm import testing
from phm.recovery.ownership import TargetBusy, TargetLocks
from tests.fakes.until import until

LIMIT_S, LONG_S = 10.0, 1e6
"""How long a lock is waited for, on the fake clock: where that is the subject, and where a busy machine must not reach it."""
REAL_S = 60.0


class TrackerCalls:
    """The calls to the tracker, in order."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, ...]] = []

    def begin_action(self, key: str, unit: str, action: str, at_most_s: float, **marks: bool) -> None:
        self.calls.append(("begin_action", key, unit))

    def end_action(self, key: str, *, worked: bool) -> None:
        self.calls.append(("end_action", key))


@pytest.fixture
def clock() -> Iterator[testing.FakeClock]:
    made = testing.FakeClock()
    yield made
    made.advance(1000)


@pytest.fixture
def calls() -> TrackerCalls:
    return TrackerCalls()


@pytest.fixture
def locks(calls: TrackerCalls, clock: testing.FakeClock) -> TargetLocks:
    return TargetLocks(cast(Any, calls), clock)


class Waiter:
    """A thread that requests one more container and, once it has it, keeps it until `go`."""

    def __init__(self, locks: TargetLocks, wanted: str, owner: object, limit_s: float = LONG_S) -> None:
        self.outcome, self.go, self.inside = "", threading.Event(), threading.Event()
        self._locks, self._wanted, self._owner, self._limit_s = locks, wanted, owner, limit_s
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            with self._locks.locked_dependent(self._wanted, self._owner, self._limit_s):
                self.inside.set()
                self.go.wait(2 * REAL_S)
            self.outcome = "done"
        except TargetBusy as error:
            self.outcome = str(error)


def pass_time(clock: testing.FakeClock) -> None:
    clock.advance(0.05)
    time.sleep(0.001)


def test_a_target_has_one_owner_at_a_time(locks: TargetLocks) -> None:
    """Only the owner releases it."""
    one, two = object(), object()
    assert locks.acquire("a", one)
    assert not locks.acquire("a", two)
    locks.release("a", two)
    assert not locks.acquire("a", two)
    locks.release("a", one)
    assert locks.acquire("a", two)


def test_an_attempt_waits_for_a_locked_dependent(locks: TargetLocks, clock: testing.FakeClock) -> None:
    """Two recoveries, one dependent: one after the other."""
    first = Waiter(locks, "side", object())
    assert first.inside.wait(REAL_S)
    second = Waiter(locks, "side", object())
    clock.wait_for_sleepers(1, REAL_S)
    clock.advance(1.0)
    clock.wait_for_sleepers(1, REAL_S)
    assert not second.inside.is_set()
    first.go.set()
    until(second.inside.is_set, "the second to enter", step=lambda: pass_time(clock))
    second.go.set()
    until(lambda: first.outcome and second.outcome, "both outcomes", step=lambda: pass_time(clock))
    assert (first.outcome, second.outcome) == ("done", "done")


def test_a_wait_for_a_lock_is_limited(locks: TargetLocks, clock: testing.FakeClock) -> None:
    """A recovery that hangs with the dependent locked delays others only for the time limit."""
    assert locks.acquire("side", object())
    repair = Waiter(locks, "side", object(), LIMIT_S)
    until(lambda: repair.outcome, "the outcome of the recovery", step=lambda: pass_time(clock))
    assert repair.outcome == "another recovery was acting on side for 10 s"


@pytest.mark.parametrize("links", [2, 3])
def test_attempts_that_wait_for_each_other_do_not_deadlock(
    locks: TargetLocks, clock: testing.FakeClock, links: int
) -> None:
    """The request that would deadlock is denied; when its owner releases, the others continue."""
    owners = [object() for _ in range(links)]
    for number, owner in enumerate(owners):
        assert locks.acquire(f"c{number}", owner)
    waiting = [Waiter(locks, f"c{number + 1}", owner) for number, owner in enumerate(owners[:-1])]
    clock.wait_for_sleepers(links - 1, REAL_S)
    with pytest.raises(TargetBusy, match="waits for this one"), locks.locked_dependent("c0", owners[-1], LIMIT_S):
        pytest.fail("a target has two owners")
    for number in range(links - 1, 0, -1):
        locks.release(f"c{number}", owners[number])
        until(waiting[number - 1].inside.is_set, f"number {number} to enter", step=lambda: pass_time(clock))
        waiting[number - 1].go.set()
        until(lambda repair=waiting[number - 1]: repair.outcome, "the next outcome", step=lambda: pass_time(clock))  # type: ignore[misc]
    assert [repair.outcome for repair in waiting] == ["done"] * (links - 1)


def test_an_action_is_ended_by_its_last_owner(locks: TargetLocks, calls: TrackerCalls) -> None:
    """A recovery that is being verified while its container is restarted for another one does not end the other's hold."""
    own, other = object(), object()
    locks.begin_action("side", own, "health/side", "restart", 60.0, verifying=True)
    locks.begin_action("side", other, "container/app", "restart", 60.0)
    locks.end_action("side", own, worked=True)
    assert calls.calls == [("begin_action", "side", "health/side"), ("begin_action", "side", "container/app")]
    locks.end_action("side", other, worked=True)
    locks.end_action("side", other, worked=True)
    assert calls.calls[2:] == [("end_action", "side")]
