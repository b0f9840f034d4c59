"""The uncertainty of a rate due to uneven publication: the rule, and the check's result on recorded traces."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest

from phm import api, testing
from phm.probes.ros.rates.estimator import WIDE_S, RateEstimator, RateUncertainty
from phm_checks.rates import Rates
from tests.fakes.ros_flow import Publication, even, feed, polls, trace

SETTLE_S = 2.0
"""`settle_s` of the rates check: a shorter failure is not published, unless conclusive."""
POLLS_A_RUN = 4
"""The check runs once a second, and immediately when a topic falls silent or its rate changes."""


def published(
    name: str, phase_s: float, publications: Sequence[Publication] | None = None
) -> list[tuple[float, float, str]]:
    """The failures that the check finds in a trace and that last long enough to be published: (begin, end, condition).

    The node has a beacon that always reports OK, so no failure is held back because of the node.
    """
    recorded = trace(name)
    publications = recorded.publications if publications is None else publications
    topic = {"name": "/t", "rate": round(recorded.hz, 1)}
    (check,) = Rates.build(testing.settings(containers=[{"name": "ros_app"}], ros={"topics": [topic]}))
    beacon = api.BeaconFact(0.0, 0.2, turns=1)
    clock, ros = testing.FakeClock(), testing.FakeRos(nodes={"/n": 1}, beacons={"/n": beacon})
    meter, ends = RateEstimator(topic["rate"], 3.0), (api.EndpointFact("/n", "std_msgs/msg/String"),)
    spans: list[tuple[float, float, str]] = []
    began_s: float | None = None
    settle_s = SETTLE_S
    for number, (now_s, samples) in enumerate(polls(publications, phase_s - 1.0, publications[-1].received_s)):
        rate = meter.update(now_s, samples)
        clock.advance(0.25)
        if rate.silent_s is None or (number % POLLS_A_RUN and rate.hz != 0.0 and rate.changed_s is None):
            continue
        ros.change(topics={"/t": api.TopicFact(ends, (), rate)}, up_s=60.0)
        results = check.run(testing.world(clock=clock, ros=ros))
        assert not isinstance(results, api.Result)
        result = results["rates/t"]
        if result.level.bad:
            began_s, condition = (now_s if began_s is None else began_s), result.condition
            settle_s = min(settle_s, SETTLE_S if result.settle_s is None else result.settle_s)
        elif began_s is not None:
            if now_s - began_s >= settle_s:
                spans.append((began_s, now_s, condition))
            began_s, settle_s = None, SETTLE_S
    if began_s is not None and now_s - began_s >= settle_s:
        spans.append((began_s, now_s, condition))
    return spans


def halved(name: str, at_s: float, end_s: float) -> list[Publication]:
    """The trace without every second sample from `at_s` on."""
    publications = trace(name).publications
    rest = [publication for publication in publications if at_s <= publication.received_s < end_s][::2]
    before = [publication for publication in publications if publication.received_s < at_s]
    first = len(before) + 1
    renumbered = [
        Publication(publication.received_s, publication.published_s, first + place)
        for place, publication in enumerate(rest)
    ]
    return before + renumbered


@pytest.mark.parametrize("phase_s", [0.0, 0.12])
@pytest.mark.parametrize("name", ["steady", "lognormal", "bursty", "stalling", "fast"])
def test_no_recorded_trace_raises_an_alarm(name: str, phase_s: float) -> None:
    """45 minutes each, with the default tolerance of 10 %: jitter, bursts and stalls are neither a wrong rate nor
    silence.
    """
    assert published(name, phase_s) == []


@pytest.mark.parametrize(
    ("name", "within_s"), [("steady", 8.0), ("stalling", 8.0), ("lognormal", 40.0), ("bursty", 40.0)]
)
def test_a_halved_rate_is_still_published(name: str, within_s: float) -> None:
    """For a steady topic after its window; for an uneven one when it exceeds the uncertainty."""
    for at_s in (300.0, 600.0, 1000.0):
        began_s, _, condition = published(name, 0.0, halved(name, at_s, at_s + 100.0))[0]
        assert condition in ("rate_low", "topic_silent")
        assert at_s < began_s <= at_s + within_s


def test_a_steady_rate_has_no_uncertainty() -> None:
    """Uneven polling is not attributed to the publisher."""
    fact = feed(RateEstimator(10.0, 3.0), even(10.0, 100.0, 30.0), 100.0, 130.0)
    assert fact.error_hz == pytest.approx(0.0, abs=1e-6)
    assert fact.window_s == pytest.approx(3.0, abs=0.3)


def test_the_uncertainty_is_unknown_until_two_windows_were_compared() -> None:
    """None is not zero."""
    assert feed(RateEstimator(10.0, 3.0), even(10.0, 100.0, 5.0), 100.0, 105.0).error_hz is None


def test_an_uneven_topic_is_measured_over_a_longer_window() -> None:
    """With an uncertainty that matches the real variation of its rate."""
    rnd, at_s, publications = random.Random(1), 100.0, []
    for number in range(600):
        at_s += rnd.lognormvariate(-0.08, 0.4)
        publications.append(Publication(at_s, at_s, number))
    meter, rates, errors = RateEstimator(1.0, 3.0), [], []
    for now_s, samples in polls(publications, 100.0, 600.0):
        fact = meter.update(now_s, samples)
        if now_s > 200.0 and fact.hz and fact.error_hz:
            rates.append(fact.hz)
            errors.append(fact.error_hz)
    assert fact.window_s == pytest.approx(WIDE_S, rel=0.3)
    mean = sum(rates) / len(rates)
    spread = (sum((hz - mean) ** 2 for hz in rates) / len(rates)) ** 0.5
    assert sum(errors) / len(errors) == pytest.approx(spread, rel=0.5)


def test_a_single_rate_change_does_not_count_as_unevenness() -> None:
    """From 10 to 5 Hz: the uncertainty stays far below the change, so that it is published."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 60.0), 100.0, 160.0)
    fact = feed(meter, even(5.0, 160.0, 6.0, first=601), 160.0, 166.0)
    assert fact.hz == pytest.approx(5.0, rel=0.01)
    assert (fact.error_hz or 0.0) < 1.0


def test_samples_after_a_silence_are_not_compared_with_earlier_ones() -> None:
    """`forget` restarts the comparison, and keeps the known unevenness."""
    spread = RateUncertainty(3.0)
    for look in range(100):
        spread.add(look * 0.25, 10.0, 3.0)
    assert spread.error_hz(3.0) == 0.0
    spread.forget()
    for look in range(100, 112):
        spread.add(look * 0.25, 5.0, 3.0)
    assert spread.error_hz(3.0) == 0.0
