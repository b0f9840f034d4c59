"""Trends of the measurements of a soak."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from phm.core.trend import line
from sitl.soak import report
from sitl.soak.slopes import MEASUREMENTS, Row, restarts, rows
from tests.fakes.soak_samples import PERIOD_S, SETTING, sample, samples


def noise(size: float) -> Callable[[], float]:
    draw = random.Random(3)
    return lambda: draw.gauss(0, size)


def row(name: str, found: list[Row]) -> Row:
    return next(each for each in found if each.measurement.name == name)


def test_a_leak_is_found_with_its_rate_and_its_agent() -> None:
    """0.5 MB an hour in one of two agents, in noise of 0.1 MB; what is constant has no trend."""
    more = noise(0.1)
    found = rows(samples(lambda agent, at_s: 60 + (0.5 * at_s / 3600 if agent == 2 else 0) + more()))
    private = row("memory, private", found)
    assert private.of[2].slope == pytest.approx(0.5, abs=0.1) and private.of[2].verdict == "grows"
    assert private.all.slope == pytest.approx(0.25, abs=0.08) and private.worst == 2
    assert private.of[1].low is not None and private.of[1].low < 0.1
    assert (row("threads", found).all.slope, row("threads", found).all.verdict) == (0.0, "no trend")


def test_a_counter_is_shown_as_a_rate() -> None:
    """CPU of 1 % of a core and five wake-ups a second, without a trend."""
    found = rows(samples(lambda agent, at_s: 60.0))
    assert row("CPU", found).all.mean == pytest.approx(1.0, rel=0.01)
    assert row("wake-ups", found).all.mean == pytest.approx(5.0, rel=0.01)
    assert row("CPU", found).all.slope == pytest.approx(0.0, abs=1e-6)


def test_the_start_of_a_program_is_not_a_leak() -> None:
    """Growth in its first minutes is not counted."""
    found = rows(samples(lambda agent, at_s: 60 + 20 * min(1.0, at_s / 300)))
    assert row("memory, private", found).all.verdict == "no trend"


def test_a_restart_does_not_hide_a_leak() -> None:
    """The slope is that of the longest run; restarts are counted."""
    taken = [
        sample(
            1, at_s, run="1/7" if at_s < 1800 else "1/9", memory_mb=60 + (at_s % 1800 if at_s < 1800 else at_s) / 3600
        )
        for at_s in (place * PERIOD_S for place in range(720))
    ]
    assert row("memory, private", rows(taken)).all.slope == pytest.approx(1.0, rel=0.01)
    assert restarts(taken) == 1


def test_few_samples_have_no_slope() -> None:
    """A soak that was interrupted immediately says so, and one without samples has a report, too."""
    few = samples(lambda agent, at_s: 60.0, hours=0.01)
    assert {each.all.verdict for each in rows(few)} == {"too short"}
    for taken in ([], few):
        found = report.document(taken, [], SETTING)
        assert len(report.table(found)) == len(MEASUREMENTS) and "NOT COMPLETE" in report.sentences(found)[0]


def test_a_line_has_its_slope_within_its_interval() -> None:
    """Of points on a line the interval is that slope; of too few there is none."""
    found = line([(float(at), 3.0 * at + 1) for at in range(20)])
    assert found is not None and (found.low, found.slope, found.high) == pytest.approx((3.0, 3.0, 3.0))
    assert line([(0.0, 1.0), (1.0, 2.0)]) is None
