"""`phm.testing`, which authors of checks rely on."""

from __future__ import annotations

import threading
from collections import Counter

import pytest

from phm import api, testing


def test_a_thread_sleeps_until_the_fake_clock_advances() -> None:
    """And no longer: the test controls the time."""
    clock, seen = testing.FakeClock(), list[float]()

    def sleep_thrice() -> None:
        for _ in range(3):
            clock.wait(threading.Event(), 10.0)
            seen.append(clock.mono())

    thread = threading.Thread(target=sleep_thrice, name="phm-test-sleeper", daemon=True)
    thread.start()
    for _ in range(3):
        clock.wait_for_sleepers(1, 60.0)
        clock.advance(10.0)
    thread.join(60)
    assert seen == [1010.0, 1020.0, 1030.0]
    assert clock.sleepers == 0


def test_an_event_wakes_a_sleeper_without_passing_time() -> None:
    """As threading.Event.wait does, with the same return value."""
    clock, event, woken = testing.FakeClock(), threading.Event(), list[bool]()
    thread = threading.Thread(target=lambda: woken.append(clock.wait(event, None)), name="phm-test-event", daemon=True)
    thread.start()
    clock.wait_for_sleepers(1, 60.0)
    event.set()
    thread.join(60)
    assert woken == [True] and clock.mono() == 1000.0


class CountingEvent(threading.Event):
    """Counts how often a thread looks at it."""

    def __init__(self) -> None:
        super().__init__()
        self.looks: Counter[int] = Counter()

    def is_set(self) -> bool:
        self.looks[threading.get_ident()] += 1
        return super().is_set()


def test_a_sleeper_does_nothing_until_its_time_has_come() -> None:
    """Thousands of threads sleep until the end of a test run: none takes the CPU from the others."""
    clock, event, never, steps = testing.FakeClock(), CountingEvent(), threading.Event(), 300

    def step() -> None:
        for _ in range(steps):
            clock.wait(never, 1.0)

    thread = threading.Thread(target=lambda: clock.wait(event, 1000.0), name="phm-test-idle", daemon=True)
    busy = threading.Thread(target=step, name="phm-test-busy", daemon=True)
    thread.start()
    busy.start()
    for _ in range(steps):
        clock.wait_for_sleepers(2)
        clock.advance(1.0)
    busy.join(60)
    assert not busy.is_alive()
    assert event.looks[thread.ident or 0] == 1
    clock.advance(1000.0)
    thread.join(60)
    assert not thread.is_alive()


def test_only_utc_jumps() -> None:
    """Setting the clock changes only UTC, and the monotonic clock never goes back."""
    clock = testing.FakeClock()
    clock.jump_utc(-5.0)
    assert (clock.stamp().mono, clock.stamp().utc) == (1000.0, 1_700_000_000.0 - 5.0)
    with pytest.raises(ValueError, match="jump_utc"):
        clock.advance(-1.0)


def test_missing_sleepers_are_an_error() -> None:
    """A test that waits for a dead thread must fail instead of hanging."""
    with pytest.raises(TimeoutError, match="expected 1"):
        testing.FakeClock().wait_for_sleepers(1, timeout_s=0.01)


def test_a_fake_fails_and_works_again_on_request() -> None:
    """A text becomes CannotTell; an exception is raised unchanged."""
    docker = testing.FakeDocker(testing.container("ros_app"))
    docker.fail("no answer")
    with pytest.raises(api.CannotTell, match="no answer"):
        docker.container("ros_app")
    docker.work()
    docker.problems["ros_app"] = api.NotPermitted("403")
    with pytest.raises(api.NotPermitted):
        docker.container("ros_app")
    assert docker.container("other") is None
