"""Rules of the trend of a measurement, and when it reaches a limit."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import pytest

from phm.core.trend import LEAST_POINTS, POINTS, Forecast, Trend, line


def observed(value: Callable[[float], float], for_s: float = 300.0, every_s: float = 5.0, **options: float) -> Trend:
    """The trend of `value` of the time, measured every `every_s` seconds for `for_s`."""
    trend = Trend(options.pop("window_s", 900.0), least_s=options.pop("least_s", 60.0), **options)
    for number in range(round(for_s / every_s) + 1):
        trend.add(number * every_s, value(number * every_s))
    return trend


def forecast(trend: Trend, limit: float) -> Forecast:
    found = trend.reaches(limit)
    assert found is not None
    return found


def test_a_straight_line_is_extrapolated_exactly() -> None:
    """Its three times are the same: nothing is uncertain."""
    found = forecast(observed(lambda at_s: 50.0 + 0.1 * at_s), limit=90.0)
    for reached_s in (found.likely_s, found.latest_s, found.earliest_s):
        assert reached_s == pytest.approx(100.0)
    assert found.slope == pytest.approx(0.1) and found.span_s == 300.0


def test_rounding_errors_are_not_noise() -> None:
    """Python before 3.12 adds up less exactly: errors that follow each other make no trend uncertain."""
    made = line([(at_s, 80.0 - 0.5 * at_s + (2e-14 if at_s < 8.0 else -2e-14)) for at_s in map(float, range(12))])
    assert made is not None
    assert (made.low, made.high) == (pytest.approx(-0.5), pytest.approx(-0.5))


def test_a_falling_measurement_reaches_a_limit_below() -> None:
    """The direction is that of the limit."""
    trend = observed(lambda at_s: 100.0 - 0.2 * at_s)
    assert forecast(trend, limit=20.0).likely_s == pytest.approx(100.0)
    assert trend.reaches(150.0) is None


@pytest.mark.parametrize("for_s", [0.0, 30.0, 55.0])
def test_a_short_observation_forecasts_nothing(for_s: float) -> None:
    """Not before `least_s`."""
    assert observed(lambda at_s: at_s, for_s=for_s).reaches(60.0) is None


def test_few_points_forecast_nothing() -> None:
    """Two points always lie on a line."""
    assert observed(lambda at_s: at_s, for_s=300.0, every_s=300.0 / (LEAST_POINTS - 2)).reaches(301.0) is None


def test_a_limit_far_ahead_is_not_forecast() -> None:
    """At most twice as far ahead as was observed."""
    trend = observed(lambda at_s: 0.1 * at_s)
    assert forecast(trend, limit=89.0).likely_s == pytest.approx(590.0)
    assert trend.reaches(91.0) is None


def test_a_trend_that_began_late_is_seen_in_the_newest_points() -> None:
    """The whole window still shows mostly the steady time before it."""
    trend = observed(lambda at_s: 50.0 + max(0.0, 0.1 * (at_s - 600.0)), for_s=720.0)
    assert forecast(trend, limit=80.0).slope == pytest.approx(0.1, rel=0.2)


def test_outliers_do_not_move_the_slope() -> None:
    """A fifth of the points are wrong by a hundred times the trend."""
    trend = observed(lambda at_s: 0.1 * at_s + (500.0 if at_s % 25.0 == 0.0 else 0.0))
    found = forecast(trend, limit=60.0)
    assert found.slope == pytest.approx(0.1, rel=0.1) and found.likely_s == pytest.approx(300.0, rel=0.15)


@pytest.mark.parametrize("at_share", [0.1, 0.5, 0.9])
def test_a_step_is_not_a_trend(at_share: float) -> None:
    """A program that loads a large file does not go on loading it."""
    assert observed(lambda at_s: 90.0 if at_s > 300.0 * at_share else 50.0).reaches(95.0) is None


def test_a_trend_that_has_stopped_is_not_extrapolated() -> None:
    """Memory that grows while a program starts."""
    assert observed(lambda at_s: min(0.2 * at_s, 40.0)).reaches(50.0) is None


def test_growth_without_end_is_forecast_with_noise() -> None:
    """The true time lies between the earliest and the latest one in most series, as the confidence says."""
    inside = 0
    for seed in range(200):
        draw = random.Random(seed)
        trend = observed(lambda at_s: 10.0 + 0.1 * at_s + draw.gauss(0.0, 1.0), for_s=600.0)  # noqa: B023
        found = forecast(trend, limit=100.0)
        inside += found.earliest_s - 10.0 <= 300.0 <= found.latest_s + 10.0
    assert inside >= 190


def test_the_latest_time_has_the_stated_confidence() -> None:
    """For noise that is correlated, too: at least 90 of 100 slopes are above the lower bound of 95 %."""
    for correlated in (0.0, 0.8):
        above = 0
        for seed in range(200):
            draw, noise = random.Random(seed), [0.0]

            def value(at_s: float) -> float:
                noise[0] = correlated * noise[0] + draw.gauss(0.0, 1.0)  # noqa: B023
                return 0.05 * at_s + noise[0]  # noqa: B023

            found = observed(value, for_s=600.0).reaches(60.0)
            above += found is None or found.latest_s >= 600.0 - 60.0
        assert above >= 180, correlated


def test_noise_alone_is_forecast_seldom() -> None:
    """Of 200 series without a trend, each seen once, at most a few reach a limit 10 standard deviations away."""
    wrong = 0
    for seed in range(200):
        draw = random.Random(seed)
        wrong += observed(lambda at_s: draw.gauss(50.0, 1.0), for_s=600.0).reaches(60.0) is not None  # noqa: B023
    assert wrong <= 2


def test_the_number_of_points_is_bounded() -> None:
    """However often it is measured; the window remains."""
    trend = observed(lambda at_s: 0.1 * at_s, for_s=3600.0, every_s=0.5)
    assert len(trend._points) <= POINTS
    found = forecast(trend, limit=400.0)
    assert 600.0 <= found.span_s <= 900.0 and found.likely_s == pytest.approx(400.0, rel=0.02)


def test_values_that_are_no_numbers_are_ignored() -> None:
    """A sensor that reports NaN."""
    trend = observed(lambda at_s: math.nan if at_s % 10.0 else 0.1 * at_s, every_s=2.0)
    assert forecast(trend, limit=60.0).likely_s == pytest.approx(300.0, rel=0.05)


def test_after_forget_it_starts_again() -> None:
    """A container that was restarted has another memory."""
    trend = observed(lambda at_s: 0.1 * at_s)
    trend.forget()
    assert trend.reaches(40.0) is None
