"""The age of timestamps from before a clock step."""

from __future__ import annotations

import pytest

from phm import testing
from phm.core.clock import MAX_STEPS, STEP_S, UNWATCHED_S, Clock, ClockSteps, SystemClock
from phm.core.model import Stamp

HOUR_S = 3600.0


def age_s(clock: Clock, utc: float) -> float:
    return clock.mono() - clock.latest(utc)


def test_an_age_without_steps_is_the_difference() -> None:
    """While the system clock is not set, it shows the age of a timestamp."""
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(90.0)
    assert age_s(clock, then) == pytest.approx(90.0)


@pytest.mark.parametrize("step_s", [HOUR_S, 5000 * HOUR_S, -HOUR_S])
def test_a_step_changes_no_age(step_s: float) -> None:
    """A timestamp from before the step is as old as the monotonic clock says."""
    clock = testing.FakeClock()
    then = clock.utc()
    clock.advance(60.0)
    clock.jump_utc(step_s)
    clock.advance(5.0)
    assert age_s(clock, then) == pytest.approx(65.0)


@pytest.mark.parametrize("before_utc", [0.0, 1_500_000_000.0, 1_700_003_600.0])
def test_an_unobserved_step_before_the_start_makes_nothing_older(before_utc: float) -> None:
    """An earlier timestamp is as old as the observation of the clock, regardless of the clock at that time."""
    clock = testing.FakeClock(mono=60.0, utc=1_700_000_000.0)
    clock.advance(90.0)
    assert age_s(clock, before_utc + 30.0) == pytest.approx(90.0)


def test_a_later_phm_continues_the_observation_if_the_clock_was_not_set() -> None:
    """Ages count a step that the earlier process has observed."""
    earlier = testing.FakeClock(mono=60.0)
    old = earlier.utc() - HOUR_S
    earlier.advance(300.0)
    written = earlier.utc()
    earlier.jump_utc(20.0)
    earlier.advance(300.0)
    later = testing.FakeClock(mono=earlier.mono() + 100.0, utc=earlier.utc() + 100.0)
    later.steps.resume(earlier.steps.kept())
    assert age_s(later, old) == pytest.approx(700.0) and age_s(later, written) == pytest.approx(400.0)


def test_an_unobserved_step_is_known_at_the_next_start() -> None:
    """The clock was set while no PHM ran: an age counts from the start of the next one."""
    earlier = testing.FakeClock(mono=60.0)
    earlier.advance(300.0)
    later = testing.FakeClock(mono=400.0, utc=earlier.utc() + 40.0 + HOUR_S)
    later.steps.resume(earlier.steps.kept())
    later.advance(5.0)
    assert age_s(later, earlier.utc()) == pytest.approx(5.0)


def test_a_step_after_a_long_gap_restarts_the_observation() -> None:
    """The clock may have been set twice while PHM was suspended."""
    steps = ClockSteps()
    steps.note(Stamp(1e9, 100.0))
    steps.note(Stamp(1e9 + 5000.0, 100.0 + 2 * UNWATCHED_S))
    assert steps.known_since() == 100.0 + 2 * UNWATCHED_S


@pytest.mark.parametrize("kept", [[(float("nan"), 1.0)], [(0.0, float("nan"))], [(0.0, -1e9)], [(0.0, 1e9)], []])
def test_invalid_periods_are_ignored(kept: list[tuple[float, float]]) -> None:
    """Damaged state of an earlier run does not change what is known about the clock."""
    clock = testing.FakeClock(mono=60.0, utc=60.0)
    clock.steps.resume(kept)
    assert clock.steps.known_since() == 60.0


def test_an_ambiguous_timestamp_belongs_to_the_current_clock() -> None:
    """The smallest possible age: doing nothing is the safe mistake."""
    clock = testing.FakeClock(mono=5000.0)
    then = clock.utc()
    clock.advance(1000.0)
    clock.jump_utc(-900.0)
    clock.advance(10.0)
    assert age_s(clock, then + 105.0) == pytest.approx(5.0)


def test_a_timestamp_in_the_future_is_from_a_clock_before_the_observation() -> None:
    """Its age is the time of the observation, never negative."""
    clock = testing.FakeClock()
    clock.advance(20.0)
    assert age_s(clock, clock.utc() + HOUR_S) == pytest.approx(20.0)


def test_drift_is_not_a_step_and_steps_are_bounded() -> None:
    """A slewed clock adds no period; of a clock that is set all the time, the newest periods are kept."""
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


def test_a_new_timestamp_of_the_system_clock_has_no_age() -> None:
    """Up to the smallest step that is noticed."""
    clock = SystemClock()
    before = clock.mono()
    assert before - STEP_S <= clock.latest(clock.utc()) <= clock.mono() + STEP_S
