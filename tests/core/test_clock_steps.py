"""Ages of things that were stamped by a clock that has been set since."""

from __future__ import annotations

import pytest

from phm import testing
from phm.clock import MAX_STEPS, Steps, SystemClock
from phm.model import Stamp

HOUR_S = 3600.0


def test_an_age_without_steps_is_the_difference() -> None:
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(90.0)
    assert clock.age_s(then) == pytest.approx(90.0)


@pytest.mark.parametrize("step_s", [HOUR_S, 5000 * HOUR_S, -HOUR_S])
def test_a_step_makes_nothing_older(step_s: float) -> None:
    """What was stamped before the clock was set is as old as the monotonic clock says."""
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(60.0)
    clock.jump_utc(step_s)
    clock.advance(5.0)
    assert clock.age_s(then) == pytest.approx(65.0)


def test_a_stamp_from_before_the_boot_has_its_age_by_the_clock_of_now() -> None:
    """A clock that begins at 1970 and is set later must not make the files of earlier flights young for ever."""
    clock = testing.FakeClock(mono=10.0, utc=10.0)
    clock.advance(20.0)
    clock.jump_utc(1_700_000_000.0)
    clock.advance(20.0)
    assert clock.age_s(1_700_000_000.0 - 24 * HOUR_S) == pytest.approx(24 * HOUR_S + 50.0)


def test_what_could_be_of_now_or_of_another_clock_is_of_now() -> None:
    """The least of the possible ages: doing nothing is the safe mistake."""
    clock = testing.FakeClock(mono=5000.0)
    then = clock.utc()
    clock.advance(1000.0)
    clock.jump_utc(-900.0)
    clock.advance(10.0)
    assert clock.age_s(then + 105.0) == pytest.approx(5.0)


def test_a_stamp_of_the_future_has_no_age() -> None:
    clock = testing.FakeClock()
    assert clock.age_s(clock.utc() + HOUR_S) is None


def test_drift_is_no_step_and_steps_are_bounded() -> None:
    """A slewed clock fills nothing; one that is set all the time keeps the newest periods."""
    steps = Steps()
    for second in range(1000):
        steps.note(Stamp(1e9 + second * 1.0005, 100.0 + second))
    assert len(steps.periods) == 1
    for number in range(10 * MAX_STEPS):
        steps.note(Stamp(1e9 + 1100 + number * 100, 1200.0 + number))
    assert len(steps.periods) <= MAX_STEPS
    newest = 1e9 + 1100 + (10 * MAX_STEPS - 1) * 100
    assert steps.age_s(newest, Stamp(newest + 1.0, 1201.0 + 10 * MAX_STEPS - 1)) == pytest.approx(1.0, abs=0.1)


def test_the_machines_clock_says_the_age_of_what_was_just_stamped() -> None:
    clock = SystemClock()
    age_s = clock.age_s(clock.utc())
    assert age_s is not None and age_s >= 0.0
