"""A rate that becomes another one is seen as soon as each look shows it; stalls and jitter are none."""

from __future__ import annotations

import random

import pytest

from phm.probes.ros.rates.estimator import RateEstimator
from phm.probes.ros.rates.publisher_stats import LOOKS, RateChange
from tests.fakes.ros_flow import Publication, even, feed, looks, trace

PHASES = (0.0, 0.06, 0.12, 0.19)


def changes(
    meter: RateEstimator, publications: list[Publication], start_s: float, end_s: float
) -> list[tuple[float, float]]:
    """When a change was first seen, each time, and the rate that was told then."""
    found, before = [], False
    for now_s, samples in looks(publications, start_s, end_s):
        fact = meter.look(now_s, samples)
        changed = fact.changed_s is not None
        if changed and not before:
            found.append((now_s, fact.hz or 0.0))
        before = changed
    return found


def halved(hz: float, phase_s: float) -> list[tuple[float, float]]:
    """Changes of a topic that has half its rate from 140 s on."""
    publications = even(hz, 100.0, 40.0) + even(hz / 2, 140.0, 10.0, first=int(hz * 40) + 1)
    return changes(RateEstimator(hz, 3.0), publications, 100.0 + phase_s, 150.0)


@pytest.mark.parametrize("phase_s", PHASES)
@pytest.mark.parametrize(("hz", "within_s"), [(4.0, 2.3), (5.0, 1.9), (10.0, 1.4), (100.0, 1.4)])
def test_half_the_rate_is_seen_after_four_looks(hz: float, within_s: float, phase_s: float) -> None:
    """And the rate is that of what came since, not a mean with what was before."""
    ((at_s, told_hz),) = halved(hz, phase_s)
    assert 140.75 <= at_s <= 140.0 + within_s
    assert told_hz == pytest.approx(hz / 2, rel=0.15)


def test_twice_the_rate_is_a_change_too() -> None:
    """Either way, and back again."""
    publications = [*even(5.0, 100.0, 30.0), *even(10.0, 130.0, 30.0, first=151), *even(5.0, 160.0, 30.0, first=451)]
    assert [round(hz) for _, hz in changes(RateEstimator(5.0, 3.0), publications, 100.0, 190.0)] == [10, 5]


def test_a_change_soon_after_another_is_seen() -> None:
    """How even the publisher is, is not yet known anew: what was known before holds."""
    publications = [
        *even(5.0, 100.0, 30.0),
        *even(2.5, 130.0, 2.0, first=151),
        *even(5.0, 132.0, 2.0, first=156),
        *even(2.5, 134.0, 4.0, first=166),
    ]
    assert [round(hz, 1) for _, hz in changes(RateEstimator(5.0, 3.0), publications, 100.0, 138.0)] == [2.5, 2.5]


def test_a_change_is_no_unevenness() -> None:
    """So the next one is judged as the first: up and down again, and the error stays far below the change."""
    meter, first, errors = RateEstimator(5.0, 3.0), 1, []
    for part in range(8):
        hz, start_s = (2.5 if part % 2 else 5.0), 100.0 + 10.0 * part
        fact = feed(meter, even(hz, start_s, 10.0, first=first), start_s, start_s + 10.0)
        first += int(hz * 10)
        errors.append(fact.error_hz or 0.0)
    assert max(errors) < 0.25


@pytest.mark.parametrize("phase_s", PHASES)
@pytest.mark.parametrize("name", ["steady", "lognormal", "bursty", "stalling", "fast"])
def test_no_recorded_trace_changes(name: str, phase_s: float) -> None:
    """Timers, jitter, bursts, stalls, and a machine whose processors are used by others: the rate stays what it is."""
    recorded = trace(name)
    assert (
        changes(RateEstimator(round(recorded.hz, 1), 3.0), recorded.publications, phase_s - 1.0, recorded.end_s) == []
    )


@pytest.mark.parametrize("stall_s", [0.4, 0.9, 2.0])
def test_a_stall_is_no_change(stall_s: float) -> None:
    """However often: one long look among those that are as ever."""
    publications, at_s = [], 100.0
    for number in range(600):
        at_s += 0.2 + (stall_s if number % 6 == 0 else 0.0)
        publications.append(Publication(at_s, at_s, number))
    assert changes(RateEstimator(5.0, 3.0), publications, 100.0, at_s) == []


def test_an_uneven_publisher_is_given_its_unevenness() -> None:
    """Each look must be off by four times of what its looks always are."""
    rnd, at_s, publications = random.Random(3), 100.0, []
    for number in range(3000):
        at_s += 0.2 * rnd.lognormvariate(-0.08, 0.4)
        publications.append(Publication(at_s, at_s, number))
    assert changes(RateEstimator(5.0, 3.0), publications, 100.0, at_s) == []


def test_a_new_publisher_is_no_change() -> None:
    """What it does is not compared with what another did."""
    publications = even(10.0, 100.0, 30.0) + even(5.0, 130.0, 30.0)
    assert changes(RateEstimator(10.0, 3.0), publications, 100.0, 160.0) == []


def test_after_a_silence_nothing_is_compared() -> None:
    """The publisher may be another one."""
    publications = even(10.0, 100.0, 30.0) + even(5.0, 140.0, 30.0, first=301)
    assert changes(RateEstimator(10.0, 3.0), publications, 100.0, 170.0) == []


def test_a_change_is_told_while_the_window_begins_with_it() -> None:
    """Then it is what the topic does."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 30.0), 100.0, 130.0)
    assert feed(meter, even(5.0, 130.0, 2.0, first=301), 130.0, 132.0).changed_s == pytest.approx(1.8, abs=0.3)
    assert feed(meter, even(5.0, 132.0, 5.0, first=311), 132.0, 137.0).changed_s is None


@pytest.mark.parametrize("odd", [[1, 1, 1, 0], [1, 1, 1, -1], [0, 0, 0, 0]])
def test_looks_must_agree_in_a_row(odd: list[int]) -> None:
    """One that is as usual, or off to the other side, begins anew."""
    pace, seconds = RateChange(), {0: 0.5, 1: 1.0, -1: 0.2}
    assert not any(pace.add(5, seconds[which], 10.0, 0.001) for which in odd)
    assert len(odd) == LOOKS


def test_without_a_rate_before_there_is_nothing_to_compare_with() -> None:
    """Nor without knowing how even the publisher is."""
    pace = RateChange()
    assert not any(pace.add(1, 1.0, None, 0.0) for _ in range(9))
    assert not any(pace.add(1, 1.0, 10.0, None) for _ in range(9))
