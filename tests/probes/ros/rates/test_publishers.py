"""Several publishers of one topic whose samples carry no sender: only their sequence numbers distinguish them."""

from __future__ import annotations

import random

import pytest

from phm.probes.ros.rates.estimator import Listening, RateEstimator
from phm.probes.ros.rates.publishers import DEPTH_MOST, MOST, PER_PUBLISHER, PublisherDemux
from tests.fakes.ros_flow import Publication, even, feed, polls

WAYS = [
    (10.0, 10.0),
    (10.0, 20.0),
    (100.0, 100.0),
    (100.0, 10.0),
    (200.0, 50.0, 10.0),
    (1.0, 1.0),
    (5.0, 7.0, 11.0),
    (400.0, 400.0),
]


def jittered(
    hz: float, seconds: float, first: int, phase_s: float, share: float, rnd: random.Random
) -> list[Publication]:
    """A timer whose publications deviate by `share` of its period."""
    times = sorted(phase_s + count / hz + rnd.gauss(0.0, share / hz) for count in range(int(seconds * hz)))
    return [Publication(at_s, at_s, first + count) for count, at_s in enumerate(times)]


@pytest.mark.parametrize("rates", WAYS, ids=str)
@pytest.mark.parametrize("start", ["together", "apart"])
@pytest.mark.parametrize("share", [0.03, 0.3])
def test_the_rates_of_several_publishers_are_added_up(rates: tuple[float, ...], start: str, share: float) -> None:
    """Equal and unequal rates, even and uneven timing, numbers that start together as in one launch, or anywhere."""
    for seed in range(3):
        rnd = random.Random(seed)
        publications = [
            publication
            for index, hz in enumerate(rates)
            for publication in jittered(
                hz, 30.0, 1 if start == "together" else rnd.randint(1, 5000), 100 + index * 0.3 / hz, share, rnd
            )
        ]
        many = Listening(publishers=len(rates), several=True)
        depth = min(DEPTH_MOST, PER_PUBLISHER * len(rates))
        fact = feed(RateEstimator(sum(rates), 3.0), publications, 100.0, 125.0, depth=depth, listening=many)
        assert fact.problem == ""
        assert fact.hz == pytest.approx(sum(rates), rel=0.03 + share / 4), (seed, rates)


def test_lines_that_cross_keep_their_slopes() -> None:
    """The faster one overtakes the slower one's numbers."""
    publications = even(20.0, 100.0, 30.0, first=1) + even(10.0, 100.02, 30.0, first=100)
    for end_s in (106.0, 110.0, 112.0, 115.0, 125.0):
        fact = feed(
            RateEstimator(30.0, 3.0), publications, 100.0, end_s, depth=16, listening=Listening(2, several=True)
        )
        assert fact.hz == pytest.approx(30.0, rel=0.02)


def test_a_publisher_that_stalls_and_catches_up_keeps_its_line() -> None:
    """50 ms late, then five samples in a burst, ten times a second: within a queue, consecutive numbers are enough."""
    times = [100 + n / 100 + (0.05 - n % 10 / 100 if n % 10 < 5 else 0.0) for n in range(2000)]
    publications = [Publication(at_s + n * 1e-7, at_s + n * 1e-7, 5000 + n) for n, at_s in enumerate(times)]
    publications += even(150.0, 100.001, 20.0)
    fact = feed(RateEstimator(250.0, 3.0), publications, 100.0, 118.0, depth=32, listening=Listening(2, several=True))
    assert (fact.hz, fact.problem) == (pytest.approx(250.0, rel=0.02), "")


def test_uneven_publishers_are_counted_while_the_queue_holds_all_samples() -> None:
    """Two of 20 Hz whose periods vary by a third: their lines are mixed up, but no sample is lost."""
    rnd = random.Random(3)
    publications = [
        Publication(at_s, at_s, number)
        for phase_s in (0.0, 0.02)
        for number, at_s in enumerate(sorted(100 + phase_s + n / 20 + rnd.gauss(0.0, 0.017) for n in range(400)))
    ]
    many = Listening(2, several=True)
    fact = feed(RateEstimator(40.0, 3.0), publications, 100.0, 118.0, depth=32, listening=many)
    assert (fact.hz, fact.problem) == (pytest.approx(40.0, rel=0.03), "")


def test_too_many_publishers_are_ambiguous() -> None:
    """Their count is reported instead of a meaningless rate."""
    count = MOST + 1
    publications = [
        publication
        for index in range(count)
        for publication in even(50.0, 100.0 + index * 0.002, 10.0, first=1 + index)
    ]
    many = Listening(publishers=count, several=True)
    fact = feed(RateEstimator(90.0, 3.0), publications, 100.0, 110.0, depth=DEPTH_MOST, listening=many)
    assert fact.hz is None
    assert fact.problem == "ambiguous: 9 publishers, whose sequence numbers cannot be distinguished"


def test_numbers_that_form_no_lines_are_ambiguous() -> None:
    """More active publishers than discovery lists, or one with random numbers."""
    rnd = random.Random(1)
    publications = [Publication(100 + n / 200, 100 + n / 200, rnd.randint(1, 10**6)) for n in range(2000)]
    meter = RateEstimator(200.0, 3.0)
    fact = feed(meter, publications, 100.0, 110.0, depth=32, listening=Listening(2, several=True))
    assert fact.problem == "ambiguous: 2 publishers, whose sequence numbers cannot be distinguished"


def test_a_restart_of_one_publisher_is_resolved() -> None:
    """One of two restarts its count: the sum is back as soon as its rate is known."""
    publications = even(10.0, 100.0, 20.0) + even(10.0, 100.03, 5.0, first=500) + even(10.0, 106.03, 14.0)
    meter = RateEstimator(20.0, 3.0)
    many = Listening(3, several=True)
    problems = {
        meter.update(now_s, samples, many).problem for now_s, samples in polls(publications, 100.0, 120.0, depth=16)
    }
    fact = meter.update(120.25, (), many)
    assert problems == {""}
    assert (fact.hz, fact.restarts) == (pytest.approx(20.0, rel=1e-3), 1)


def test_the_number_of_lines_is_bounded() -> None:
    """Each random number starts a new line; the oldest lines are dropped."""
    sorter, rnd = PublisherDemux(3.0), random.Random(1)
    for _, samples in polls(
        [Publication(n / 50, n / 50, rnd.randint(1, 10**9)) for n in range(5000)], 0.0, 100.0, depth=64
    ):
        if samples:
            sorter.sort(samples, 2, complete=True)
    assert len(sorter._lines) <= 2 * MOST
