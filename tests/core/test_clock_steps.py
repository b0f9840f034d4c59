"""Ages of things that were stamped by a clock that has been set since."""

from __future__ import annotations

import pytest

from phm import testing
from phm.core.clock import MAX_STEPS, STEP_S, UNWATCHED_S, Clock, ClockSteps, SystemClock
from phm.core.model import Stamp

HOUR_S = 3600.0


def age_s(clock: Clock, utc: float) -> float:
    return clock.mono() - clock.latest(utc)


def test_an_age_without_steps_is_the_difference() -> None:
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(90.0)
    assert age_s(clock, then) == pytest.approx(90.0)


@pytest.mark.parametrize("step_s", [HOUR_S, 5000 * HOUR_S, -HOUR_S])
def test_a_step_makes_nothing_older(step_s: float) -> None:
    """What was stamped before the clock was set is as old as the monotonic clock says."""
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(60.0)
    clock.jump_utc(step_s)
    clock.advance(5.0)
    assert age_s(clock, then) == pytest.approx(65.0)


@pytest.mark.parametrize("before_utc", [0.0, 1_500_000_000.0, 1_700_003_600.0])
def test_a_step_before_the_clock_was_watched_makes_nothing_older(before_utc: float) -> None:
    """What was stamped before is as old as the watching, whatever the clock was set to then."""
    clock = testing.FakeClock(mono=60.0, utc=1_700_000_000.0)
    clock.advance(90.0)
    assert age_s(clock, before_utc + 30.0) == pytest.approx(90.0)


def test_a_later_phm_goes_on_watching_where_the_clock_was_not_set_meanwhile() -> None:
    earlier = testing.FakeClock(mono=60.0)
    old = earlier.utc() - HOUR_S
    earlier.advance(300.0)
    written = earlier.utc()
    earlier.jump_utc(20.0)
    earlier.advance(300.0)
    later = testing.FakeClock(mono=earlier.mono() + 100.0, utc=earlier.utc() + 100.0)
    later.steps.resume(earlier.steps.kept())
    assert age_s(later, old) == pytest.approx(700.0) and age_s(later, written) == pytest.approx(400.0)


def test_a_clock_that_was_set_while_none_was_watching_is_known_from_then_on() -> None:
    earlier = testing.FakeClock(mono=60.0)
    earlier.advance(300.0)
    later = testing.FakeClock(mono=400.0, utc=earlier.utc() + 40.0 + HOUR_S)
    later.steps.resume(earlier.steps.kept())
    later.advance(5.0)
    assert age_s(later, earlier.utc()) == pytest.approx(5.0)


def test_a_step_after_a_long_time_without_a_look_begins_the_watching_again() -> None:
    """The clock may have been set twice while PHM was suspended."""
    steps = ClockSteps()
    steps.note(Stamp(1e9, 100.0))
    steps.note(Stamp(1e9 + 5000.0, 100.0 + 2 * UNWATCHED_S))
    assert steps.known_since() == 100.0 + 2 * UNWATCHED_S


@pytest.mark.parametrize("kept", [[(float("nan"), 1.0)], [(0.0, float("nan"))], [(0.0, -1e9)], [(0.0, 1e9)], []])
def test_periods_that_make_no_sense_count_for_nothing(kept: list[tuple[float, float]]) -> None:
    clock = testing.FakeClock(mono=60.0, utc=60.0)
    clock.steps.resume(kept)
    assert clock.steps.known_since() == 60.0


def test_what_could_be_of_now_or_of_another_clock_is_of_now() -> None:
    """The least of the possible ages: doing nothing is the safe mistake."""
    clock = testing.FakeClock(mono=5000.0)
    then = clock.utc()
    clock.advance(1000.0)
    clock.jump_utc(-900.0)
    clock.advance(10.0)
    assert age_s(clock, then + 105.0) == pytest.approx(5.0)


def test_a_stamp_that_lies_ahead_is_of_a_clock_before_the_watching() -> None:
    clock = testing.FakeClock()
    clock.advance(20.0)
    assert age_s(clock, clock.utc() + HOUR_S) == pytest.approx(20.0)


def test_drift_is_no_step_and_steps_are_bounded() -> None:
    """A slewed clock fills nothing; one that is set all the time keeps the newest periods."""
    steps = ClockSteps()
    for second in range(1000):
        steps.note(Stamp(1e9 + second * 1.0005, 100.0 + second))
    assert len(steps.kept()) == 1
    for number in range(10 * MAX_STEPS):
        steps.note(Stamp(1e9 + 1100 + number * 100, 1100.0 + number))
    assert len(steps.kept()) == MAX_STEPS
    newest = 10 * MAX_STEPS - 1
    assert steps.latest(1e9 + 1100 + newest * 100) == pytest.approx(1100.0 + newest, abs=0.1)
    assert steps.known_since() >= 1100.0 + newest - MAX_STEPS


def test_the_machines_clock_says_the_age_of_what_was_just_stamped() -> None:
    clock = SystemClock()
    before = clock.mono()
    assert before - STEP_S <= clock.latest(clock.utc()) <= clock.mono() + STEP_S
