"""A changed rate is detected as soon as each poll shows it; stalls and jitter are not changes."""

from __future__ import annotations

import random

import pytest

from phm.probes.ros.rates.estimator import RateEstimator
from phm.probes.ros.rates.publisher_stats import POLLS, RateChange
from tests.fakes.ros_flow import Publication, even, feed, polls, trace

PHASES = (0.0, 0.06, 0.12, 0.19)


def changes(
    meter: RateEstimator, publications: list[Publication], start_s: float, end_s: float
) -> list[tuple[float, float]]:
    """When a change was first detected, each time, and the rate reported then."""
    found, before = [], False
    for now_s, samples in polls(publications, start_s, end_s):
        fact = meter.update(now_s, samples)
        changed = fact.changed_s is not None
        if changed and not before:
            found.append((now_s, fact.hz or 0.0))
        before = changed
    return found


def halved(hz: float, phase_s: float) -> list[tuple[float, float]]:
    """Changes of a topic whose rate halves at 140 s."""
    publications = even(hz, 100.0, 40.0) + even(hz / 2, 140.0, 10.0, first=int(hz * 40) + 1)
    return changes(RateEstimator(hz, 3.0), publications, 100.0 + phase_s, 150.0)


@pytest.mark.parametrize("phase_s", PHASES)
@pytest.mark.parametrize(("hz", "within_s"), [(4.0, 2.3), (5.0, 1.9), (10.0, 1.4), (100.0, 1.4)])
def test_a_halved_rate_is_detected_after_four_polls(hz: float, within_s: float, phase_s: float) -> None:
    """And the rate is that of the samples since then, not a mean with earlier ones."""
    ((at_s, reported_hz),) = halved(hz, phase_s)
    assert 140.75 <= at_s <= 140.0 + within_s
    assert reported_hz == pytest.approx(hz / 2, rel=0.15)


def test_a_doubled_rate_is_a_change() -> None:
    """Up, and back down again."""
    publications = [*even(5.0, 100.0, 30.0), *even(10.0, 130.0, 30.0, first=151), *even(5.0, 160.0, 30.0, first=451)]
    assert [round(hz) for _, hz in changes(RateEstimator(5.0, 3.0), publications, 100.0, 190.0)] == [10, 5]


def test_a_change_soon_after_another_is_detected() -> None:
    """The publisher's regularity is not measured again yet: the earlier value applies."""
    publications = [
        *even(5.0, 100.0, 30.0),
        *even(2.5, 130.0, 2.0, first=151),
        *even(5.0, 132.0, 2.0, first=156),
        *even(2.5, 134.0, 4.0, first=166),
    ]
    assert [round(hz, 1) for _, hz in changes(RateEstimator(5.0, 3.0), publications, 100.0, 138.0)] == [2.5, 2.5]


def test_a_change_does_not_count_as_unevenness() -> None:
    """So the next change is judged like the first: up and down again, and the error stays far below the change."""
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
    """Timers, jitter, bursts, stalls, and a machine whose cores are busy with other processes: the rate is unchanged."""
    recorded = trace(name)
    assert (
        changes(RateEstimator(round(recorded.hz, 1), 3.0), recorded.publications, phase_s - 1.0, recorded.end_s) == []
    )


@pytest.mark.parametrize("stall_s", [0.4, 0.9, 2.0])
def test_a_stall_is_not_a_change(stall_s: float) -> None:
    """However often: one long poll interval among usual ones."""
    publications, at_s = [], 100.0
    for number in range(600):
        at_s += 0.2 + (stall_s if number % 6 == 0 else 0.0)
        publications.append(Publication(at_s, at_s, number))
    assert changes(RateEstimator(5.0, 3.0), publications, 100.0, at_s) == []


def test_an_uneven_publisher_gets_a_wider_tolerance() -> None:
    """Each poll must deviate by four times the usual deviation."""
    rnd, at_s, publications = random.Random(3), 100.0, []
    for number in range(3000):
        at_s += 0.2 * rnd.lognormvariate(-0.08, 0.4)
        publications.append(Publication(at_s, at_s, number))
    assert changes(RateEstimator(5.0, 3.0), publications, 100.0, at_s) == []


def test_a_new_publisher_is_not_a_change() -> None:
    """Its rate is not compared with that of another publisher."""
    publications = even(10.0, 100.0, 30.0) + even(5.0, 130.0, 30.0)
    assert changes(RateEstimator(10.0, 3.0), publications, 100.0, 160.0) == []


def test_nothing_is_compared_after_a_silence() -> None:
    """The publisher may be a different one."""
    publications = even(10.0, 100.0, 30.0) + even(5.0, 140.0, 30.0, first=301)
    assert changes(RateEstimator(10.0, 3.0), publications, 100.0, 170.0) == []


def test_a_change_is_reported_while_the_window_begins_with_it() -> None:
    """Later the new rate is the normal one."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 30.0), 100.0, 130.0)
    assert feed(meter, even(5.0, 130.0, 2.0, first=301), 130.0, 132.0).changed_s == pytest.approx(1.8, abs=0.3)
    assert feed(meter, even(5.0, 132.0, 5.0, first=311), 132.0, 137.0).changed_s is None


@pytest.mark.parametrize("odd", [[1, 1, 1, 0], [1, 1, 1, -1], [0, 0, 0, 0]])
def test_consecutive_polls_must_agree(odd: list[int]) -> None:
    """A poll that is as usual, or deviates in the other direction, restarts the count."""
    pace, seconds = RateChange(), {0: 0.5, 1: 1.0, -1: 0.2}
    assert not any(pace.add(5, seconds[which], 10.0, 0.001) for which in odd)
    assert len(odd) == POLLS


def test_no_change_is_detected_without_an_earlier_rate() -> None:
    """Nor without a known regularity of the publisher."""
    pace = RateChange()
    assert not any(pace.add(1, 1.0, None, 0.0) for _ in range(9))
    assert not any(pace.add(1, 1.0, 10.0, None) for _ in range(9))
