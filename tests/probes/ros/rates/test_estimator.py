"""Rates estimated from sequence numbers and publication times."""

from __future__ import annotations

import random

import pytest

from phm.facts.ros import RateFact
from phm.probes.ros.rates.estimator import STALL_S, Listening, RateEstimator
from phm.probes.ros.rates.publisher_stats import Sample
from tests.fakes.ros_flow import TICK_S, even, feed, polls, quiet

TWO = Listening(publishers=2, several=True)


def one(hz: float, seconds: float, *, expected: float | None = None, **how: object) -> RateFact:
    """The fact about an even publisher after `seconds`."""
    return feed(RateEstimator(expected or hz, 3.0), even(hz, 100.0, seconds, **how), 100.0, 100.0 + seconds)  # type: ignore[arg-type]


@pytest.mark.parametrize("hz", [0.5, 1.0, 7.3, 10.0, 200.0, 1000.0, 5000.0])
def test_the_rate_is_exact_at_any_speed(hz: float) -> None:
    """One sample per tick is enough, from 0.5 Hz to several kilohertz."""
    assert one(hz, 20.0).hz == pytest.approx(hz, rel=1e-3)


def test_a_topic_of_one_sample_a_minute_has_a_rate() -> None:
    """Below 0.1 Hz the window is three periods, and three periods without a sample are not yet silence."""
    meter = RateEstimator(1 / 60, 3.0)
    fact = feed(meter, even(1 / 60, 0.0, 600.0), 0.0, 600.0)
    assert fact.hz == pytest.approx(1 / 60, rel=1e-3)
    assert fact.window_s == pytest.approx(180.0)
    assert fact.limit_s == 180.0


def test_a_clock_step_does_not_distort_a_slow_rate() -> None:
    """A jump of five seconds is a quarter of a 20 s period, and does not count as a period."""
    meter = RateEstimator(0.05, 3.0)
    feed(meter, even(0.05, 0.0, 100.0), 0.0, 100.0)
    later = even(0.05, 100.0, 60.0, first=6, offset_s=5.0)
    fact = feed(meter, later, 100.0, 160.0)
    assert fact.hz == pytest.approx(0.05, rel=1e-3)


def test_all_samples_are_counted_without_sequence_numbers() -> None:
    """Middleware without sequence numbers: a deep queue is drained, and the rate is just as exact."""
    fact = feed(RateEstimator(40.0, 3.0), even(40.0, 100.0, 10.0, numbered=False), 100.0, 110.0, depth=40)
    assert fact.hz == pytest.approx(40.0, rel=1e-3)


def test_samples_that_were_overwritten_while_phm_did_not_run_are_no_low_rate() -> None:
    """Without sequence numbers, a full queue after a late poll is not all that was published."""
    meter, found = RateEstimator(10.0, 3.0), list[float | None]()
    for now_s, samples in polls(even(10.0, 100.0, 60.0, numbered=False), 100.0, 160.0, depth=10, tick_s=1.5):
        found.append(meter.update(now_s, samples, Listening(complete=len(samples) < 10)).hz)
    assert all(hz is None or hz == pytest.approx(10.0, rel=0.1) for hz in found)


def test_a_rate_is_kept_while_samples_are_overwritten() -> None:
    """It was measured before PHM got little CPU."""
    meter, publications = RateEstimator(10.0, 3.0), even(10.0, 100.0, 60.0, numbered=False)
    feed(meter, publications, 100.0, 130.0, depth=10)
    late = [publication for publication in publications if publication.received_s > 130.0]
    assert feed(meter, late, 130.0, 160.0, depth=10, tick_s=1.5).hz == pytest.approx(10.0, rel=0.01)


def test_a_slower_publisher_is_seen_while_samples_are_overwritten() -> None:
    """The samples that are left in one queue are enough."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 30.0, numbered=False), 100.0, 130.0, depth=10)
    slower = even(6.0, 130.0, 60.0, numbered=False)
    assert feed(meter, slower, 130.0, 180.0, depth=10, tick_s=5.0).hz == pytest.approx(6.0, rel=0.01)


def test_two_samples_close_together_give_no_rate() -> None:
    """With less than one second of publication time the rate is unknown, not wrong."""
    fact = one(10.0, 0.5)
    assert (fact.hz, fact.silent_s) == (None, 0.0)


def test_before_the_first_sample_nothing_is_known() -> None:
    """A topic that was never received has no rate, silence or age, however long PHM waits."""
    fact = quiet(RateEstimator(10.0, 3.0), 100.0, 20.0)
    assert (fact.hz, fact.silent_s, fact.samples, fact.age_s, fact.sample_bytes) == (None, None, 0, None, None)


@pytest.mark.parametrize(("hz", "limit_s"), [(10.0, 3.0), (0.5, 6.0)])
def test_silence_is_three_periods_or_the_configured_time(hz: float, limit_s: float) -> None:
    """Of a recently discovered topic: up to the limit the last rate is kept; beyond it the rate is 0.0 and silence is
    counted.
    """
    meter = RateEstimator(hz, 3.0)
    fact = feed(meter, even(hz, 100.0, 10.0), 100.0, 110.0)
    assert fact.limit_s == limit_s
    assert quiet(meter, 110.0, limit_s).hz == pytest.approx(hz, rel=1e-3)
    silent = quiet(meter, 110.0 + limit_s, TICK_S)
    assert silent.hz == 0.0
    assert silent.silent_s == pytest.approx(limit_s + TICK_S)


def test_the_rate_is_measured_again_after_a_silence() -> None:
    """The silence is not averaged into the rate that follows it."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 5.0), 100.0, 105.0)
    quiet(meter, 105.0, 8.0)
    fact = feed(meter, even(10.0, 113.0, 5.0, first=51), 113.0, 118.0)
    assert fact.hz == pytest.approx(10.0, rel=1e-3)


def test_no_topic_is_silent_while_phm_is_suspended() -> None:
    """Late polls are PHM's own delay; a topic can only be found silent while it is polled."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 5.0), 100.0, 105.0)
    assert meter.update(125.0, ()).hz == pytest.approx(10.0, rel=1e-3)
    assert quiet(meter, 125.0, 3.0 - STALL_S / 2).hz != 0.0
    assert quiet(meter, 125.0 + 3.0 - STALL_S / 2, TICK_S).hz == 0.0


def test_a_restarted_publisher_is_measured_again_and_counted() -> None:
    """Falling sequence numbers mean a restarted publisher, neither a negative rate nor ambiguity."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 10.0, first=5000), 100.0, 110.0)
    fact = feed(meter, even(20.0, 110.0, 5.0), 110.0, 115.0)
    assert (fact.problem, fact.restarts) == ("", 1)
    assert fact.hz == pytest.approx(20.0, rel=1e-3)


def test_a_publisher_with_an_identity_that_replaces_another_is_counted() -> None:
    """Where the middleware identifies the writer, a restart shows a new identity, and samples of the old one are not
    added.
    """
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 10.0, writer=b"a"), 100.0, 110.0)
    fact = feed(meter, even(10.0, 110.5, 5.0, writer=b"b"), 110.0, 115.5)
    assert fact.restarts == 1
    assert fact.hz == pytest.approx(10.0, rel=1e-3)


def two_publishers(hz: float, expected_hz: float, head_start_s: float) -> RateFact:
    """Two publishers of one node, as the topic monitor polls them: separated once their numbers are found to be mixed."""
    meter, several, fact = RateEstimator(expected_hz, 3.0), False, RateFact(None, None)
    both = even(hz, 100.0, 25.0) + even(hz, 100.0 + head_start_s, 25.0 - head_start_s)
    for now_s, samples in polls(both, 100.0, 125.0, depth=32):
        several = several or meter.mixed(now_s)
        fact = meter.update(now_s, samples, Listening(2, several=several, complete=len(samples) < 32))
    return fact


@pytest.mark.parametrize("hz", [1.0, 10.0, 300.0])
@pytest.mark.parametrize("pause_s", [0.3, 2.0, 6.0])
@pytest.mark.parametrize("depth", [1, 32])
def test_a_restart_is_counted_while_the_killed_publisher_is_listed(hz: float, pause_s: float, depth: int) -> None:
    """One sequence has ended and another has begun: one restart, however long the pause was."""
    meter = RateEstimator(hz, 3.0)
    feed(meter, even(hz, 100.0, 40.0), 100.0, 140.0)
    assert feed(meter, even(hz, 140.0 + pause_s, 12.0), 140.0, 155.0, depth=depth).restarts == 1


@pytest.mark.parametrize(
    ("hz", "expected_hz"), [(0.2, 0.4), (1.0, 1.0), (1.0, 2.0), (4.0, 8.0), (10.0, 20.0), (50.0, 50.0)]
)
@pytest.mark.parametrize("head_start_s", [0.03, 0.3, 3.07, 8.13])
def test_two_live_publishers_are_not_a_restart(hz: float, expected_hz: float, head_start_s: float) -> None:
    """The second one begins at 1 beside the first, as a restarted node would; the first continues."""
    assert two_publishers(hz, expected_hz, head_start_s).restarts == 0


def test_a_publisher_that_resumes_was_not_restarted() -> None:
    """With an identity: a publisher pauses while a new one begins, and then continues."""
    meter, two = RateEstimator(10.0, 3.0), Listening(publishers=2, several=True)
    pausing = even(10.0, 100.0, 5.0, writer=b"a")
    other = even(10.0, 105.1, 20.0, writer=b"b")
    assert feed(meter, [*pausing, *other], 100.0, 110.0, depth=32, listening=two).restarts == 1
    back = even(10.0, 110.0, 5.0, first=51, writer=b"a")
    rest = [publication for publication in other if publication.received_s > 110.0]
    assert feed(meter, [*back, *rest], 110.0, 115.0, depth=32, listening=two).restarts == 0


def test_another_node_that_takes_over_is_counted_without_an_identity() -> None:
    """The numbers are separated once two nodes are listed; earlier samples are not forgotten."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 20.0), 100.0, 120.0)
    fact = feed(meter, even(10.0, 121.0, 9.0), 120.0, 130.0, depth=32, listening=TWO)
    assert (fact.restarts, fact.problem, fact.hz) == (1, "", pytest.approx(10.0, rel=1e-2))


def test_the_rate_is_kept_when_a_killed_publisher_is_delisted() -> None:
    """The lease of a killed publisher ends: the remaining one was measured all the time."""
    meter = RateEstimator(10.0, 3.0)
    both = even(10.0, 100.0, 10.0, first=700) + even(10.0, 100.03, 4.0)
    feed(meter, both, 100.0, 110.0, depth=32, listening=TWO)
    fact = feed(meter, even(10.0, 110.0, 0.3, first=800), 110.0, 110.25)
    assert (fact.restarts, fact.hz) == (0, pytest.approx(10.0, rel=1e-2))


@pytest.mark.parametrize("step_s", [-3600.0, -2.0, 2.0, 3600.0])
def test_a_clock_that_was_set_does_not_distort_the_rate(step_s: float) -> None:
    """A jump of the publisher's clock begins a new window, and is neither a restart nor silence."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 5.0), 100.0, 105.0)
    fact = feed(meter, even(10.0, 105.0, 5.0, first=51, offset_s=step_s), 105.0, 110.0)
    assert fact.hz == pytest.approx(10.0, rel=1e-3)
    assert (fact.restarts, fact.problem) == (0, "")
    assert fact.age_s == pytest.approx(0.0, abs=1e-3)


def test_two_publishers_in_one_node_are_recognized_by_their_numbers() -> None:
    """Discovery may list one, but the numbers keep falling: then they must be separated."""
    meter = RateEstimator(10.0, 3.0)
    both = even(10.0, 100.0, 5.0, first=5000) + even(10.0, 100.13, 5.0, first=100)
    feed(meter, both, 100.0, 105.0)
    assert meter.mixed(105.0)
    alone = RateEstimator(10.0, 3.0)
    feed(alone, even(10.0, 100.0, 5.0), 100.0, 105.0)
    assert not alone.mixed(105.0)


def test_publishers_with_an_identity_are_added_up() -> None:
    """Where the middleware identifies the writer, the rate is the sum of both publishers."""
    both = even(10.0, 100.0, 5.0, writer=b"a") + even(5.0, 100.03, 5.0, writer=b"b")
    fact = feed(RateEstimator(10.0, 3.0), both, 100.0, 105.0, depth=16, listening=TWO)
    assert (fact.hz, fact.publishers) == (pytest.approx(15.0, rel=1e-3), 2)


def test_one_of_two_publishers_that_falls_silent_leaves_the_sum() -> None:
    """The topic is not silent, and its rate is that of the other one."""
    meter = RateEstimator(20.0, 3.0)
    both = even(10.0, 100.0, 5.0, first=300) + even(10.0, 100.04, 10.0, first=7)
    assert feed(meter, both, 100.0, 105.0, depth=16, listening=TWO).hz == pytest.approx(20.0, rel=1e-2)
    rest = [publication for publication in both if publication.received_s > 105.0]
    assert feed(meter, rest, 105.0, 110.0, depth=16, listening=TWO).hz == pytest.approx(10.0, rel=1e-3)


def test_counted_samples_of_two_publishers_are_their_sum() -> None:
    """Without sequence numbers a deep queue contains the samples of all publishers."""
    both = even(10.0, 100.0, 6.0, numbered=False) + even(5.0, 100.03, 6.0, numbered=False)
    fact = feed(RateEstimator(15.0, 3.0), both, 100.0, 106.0, depth=40, listening=TWO)
    assert fact.hz == pytest.approx(15.0, rel=0.05)


def test_the_jitter_of_a_slow_topic_is_the_spread_of_its_periods() -> None:
    """At 2 Hz each period is measured separately."""
    rnd = random.Random(1)
    publications, at_s = [], 100.0
    for number in range(200):
        at_s += rnd.gauss(0.5, 0.05)
        publications.append(even(1.0, at_s - 1.0, 1.0, first=number + 1)[0])
    fact = feed(RateEstimator(2.0, 3.0), publications, 100.0, 195.0)
    assert fact.jitter_s == pytest.approx(0.05, rel=0.3)


@pytest.mark.parametrize(("hz", "off_s"), [(100.0, 0.002), (10.0, 0.02)])
def test_the_jitter_of_a_fast_timer_is_that_of_its_period(hz: float, off_s: float) -> None:
    """A timer's publications deviate by sigma each from a regular period, so the periods deviate by sigma times
    sqrt(2).
    """
    rnd = random.Random(2)
    publications = [
        even(hz, 100.0 + count / hz + rnd.gauss(0.0, off_s), 1 / hz, first=count + 1)[0]
        for count in range(int(60 * hz))
    ]
    publications.sort(key=lambda publication: publication.sequence or 0)
    fact = feed(RateEstimator(hz, 3.0), publications, 100.0, 160.0)
    assert fact.jitter_s == pytest.approx(off_s * 2**0.5, rel=0.3)


def test_an_even_publisher_has_no_jitter() -> None:
    """Uneven polling is not attributed to the publisher."""
    fact = one(7.3, 20.0)
    assert fact.jitter_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("offset_s", [0.0, -86400.0, 3.0])
def test_the_age_of_the_newest_sample_does_not_depend_on_the_publishers_clock(offset_s: float) -> None:
    """It is measured relative to the fastest delivery; the clock of another host may show any time."""
    meter = RateEstimator(1.0, 3.0)
    fact = feed(meter, even(1.0, 100.0, 10.0, offset_s=offset_s, delay_s=0.005), 100.0, 110.5)
    assert fact.age_s == pytest.approx(0.5 - 0.005, abs=0.01)


def test_late_samples_are_old() -> None:
    """A sample that took one second longer than others is one second older."""
    meter = RateEstimator(10.0, 3.0)
    feed(meter, even(10.0, 100.0, 5.0), 100.0, 105.0)
    late = even(10.0, 105.0, 5.0, first=51, delay_s=0.9)
    assert feed(meter, late, 105.0, 109.0).age_s == pytest.approx(0.9, abs=0.01)


def test_a_latched_topic_has_the_age_of_its_sample_and_is_never_silent() -> None:
    """It is also sent to later subscribers: its age follows from the unadjusted clocks."""
    meter = RateEstimator(0.0, 3.0)
    (sample,) = even(1.0, 99.0, 1.0, offset_s=-3600.0)
    fact = feed(meter, [sample], 99.0, 150.0)
    assert fact.age_s == pytest.approx(3650.0)
    assert (fact.hz, fact.limit_s, fact.sample_bytes) == (None, None, 100.0)


def test_a_latched_sample_from_the_future_has_no_age() -> None:
    """The publisher's host has another clock: the age is unknown and not reported."""
    (sample,) = even(1.0, 99.0, 1.0, offset_s=3600.0)
    assert feed(RateEstimator(0.0, 3.0), [sample], 99.0, 110.0).age_s is None


def test_a_large_topic_is_measured_across_its_windows() -> None:
    """Numbers and stamps continue while PHM does not subscribe: a window every few seconds gives the exact rate."""
    meter = RateEstimator(30.0, 3.0)
    closed = Listening(on=False, closed_s=2.0)
    publications = even(30.0, 100.0, 30.0, size=1_000_000)
    for window in range(10):
        at_s = 100.0 + 3.0 * window
        quiet(meter, at_s, 2.5, closed)
        seen = [publication for publication in publications if at_s + 2.5 < publication.received_s <= at_s + 3.0]
        fact = feed(meter, seen, at_s + 2.5, at_s + 3.0, listening=Listening(closed_s=2.0))
    assert fact.hz == pytest.approx(30.0, rel=1e-3)
    assert fact.sample_bytes == 1_000_000
    assert quiet(meter, 130.0, 60.0, closed).hz == pytest.approx(30.0, rel=1e-3)
    assert fact.limit_s == 3.0 + 2.0
    assert quiet(meter, 190.0, 3.5, Listening(closed_s=2.0)).hz == 0.0


def test_nothing_is_missing_without_a_rate_to_compare_with() -> None:
    """Neither measured yet nor expected."""
    meter = RateEstimator(0.0, 3.0)
    feed(meter, even(20.0, 100.0, 0.5), 100.0, 100.5)
    assert meter.missing_s([Sample(11, int(103.0 * 1e9), 103.0)], Listening()) == 0.0


def test_a_counted_topic_keeps_its_rate_between_windows() -> None:
    """Where samples are counted, those between windows are unknown: each window is a separate measurement."""
    meter = RateEstimator(20.0, 3.0)
    for window in range(3):
        at_s = 100.0 + 5.0 * window
        meter.hold()
        feed(meter, even(20.0, at_s, 1.5, numbered=False), at_s, at_s + 1.5, depth=20)
        fact = quiet(meter, at_s + 1.5, 3.5, Listening(on=False, closed_s=2.0))
        assert fact.hz == pytest.approx(20.0, rel=0.01)
    meter.hold()
    assert feed(meter, even(20.0, 115.0, 0.5, numbered=False), 115.0, 115.5, depth=20).hz == pytest.approx(
        20.0, rel=0.01
    )


def test_a_problem_replaces_the_rate() -> None:
    """An unknown rate is not reported."""
    meter = RateEstimator(10.0, 3.0)
    fact = feed(meter, even(10.0, 100.0, 5.0), 100.0, 105.0, listening=Listening(problem="type unknown: x"))
    assert (fact.hz, fact.problem) == (None, "type unknown: x")
