"""A difference is called new, gone, worse or better, and chance is not taken for change."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from phm.review import comparison
from phm.review.statistics import rate_limits, same_rate
from tests.review.records import Flown, report


def flight(folder: Path, *units: str) -> Path:
    """1000 s in which these units fail one after another, each for 2 s."""
    made = Flown(folder)
    for number, unit in enumerate(units, 1):
        made.until(10 * number)
        made.fail(unit, lasts=2.0)
    made.until(1000)
    made.report()
    made.close()
    return folder


def rows(first: Path, second: Path) -> dict[str, dict[str, object]]:
    return {row["check"]: row for row in comparison.build(report(first), report(second))["checks"]}


def test_new_gone_worse_and_better_faults_are_named(tmp_path: Path) -> None:
    """By the rates of faults, with their numbers."""
    first = flight(tmp_path / "a", "nodes/node_1", "nodes/node_1", "container/ros_app")
    second = flight(tmp_path / "b", "nodes/node_1", "rates/topic_1")
    found = rows(first, second)
    assert {check: row["verdict"] for check, row in found.items()} == {
        "nodes": "better",
        "container": "gone",
        "rates": "new",
    }
    assert found["nodes"]["faults"] == [2, 1]
    assert found["nodes"]["per_hour"] == [7.2, 3.6]
    assert all(row["chance"] for row in found.values())


def test_twelve_faults_after_none_are_no_chance(tmp_path: Path) -> None:
    """In equal times the probability is two times 0.5 to the power of 12."""
    found = rows(flight(tmp_path / "a"), flight(tmp_path / "b", *["nodes/node_1"] * 12))
    assert found["nodes"]["verdict"] == "new"
    assert found["nodes"]["probability"] == pytest.approx(2 * 0.5**12, abs=1e-6)
    assert not found["nodes"]["chance"]


@pytest.mark.parametrize(
    ("count", "low", "high"), [(0, 0.0, 3.6889), (1, 0.0253, 5.5716), (10, 4.7954, 18.3904), (100, 81.3638, 121.6266)]
)
def test_limits_of_a_rate_are_those_of_the_published_table(count: int, low: float, high: float) -> None:
    """Garwood's exact 95 % interval of the mean of a Poisson variable."""
    assert rate_limits(count, 1.0) == pytest.approx((low, high), abs=2e-4)


def test_the_test_of_two_rates_is_the_binomial_one() -> None:
    """Given the sum, the first count is binomial; summed over all that are as unlikely."""
    p = 0.25
    each = [math.comb(8, k) * p**k * (1 - p) ** (8 - k) for k in range(9)]
    by_hand = sum(one for one in each if one <= each[5] + 1e-12)
    assert same_rate(5, 100.0, 3, 300.0) == pytest.approx(by_hand)
    assert same_rate(0, 1.0, 0, 1.0) == 1.0
    assert same_rate(1, 0.0, 1, 1.0) is None
    assert same_rate(30_000, 1.0, 30_100, 1.0) == pytest.approx(0.683, abs=0.01)


def test_many_comparisons_make_chance_more_likely() -> None:
    """Holm: the smallest is multiplied by the number of comparisons, the next by one less, never below the one before."""
    assert comparison.holm([0.01, None, 0.04, 0.03]) == [
        pytest.approx(0.03),
        None,
        pytest.approx(0.06),
        pytest.approx(0.06),
    ]
