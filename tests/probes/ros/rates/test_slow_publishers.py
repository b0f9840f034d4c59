"""Several publishers of one topic, some of them slow: the rate of all is known, and not too low while one is not known yet."""

from __future__ import annotations

import pytest

from phm.probes.ros.rates.estimator import Listening, RateEstimator
from phm.probes.ros.rates.publishers import DEPTH_MOST, PER_PUBLISHER
from tests.fakes.ros_flow import Publication, even, polls

START_S = 100.0
NAMED = pytest.mark.parametrize("named", [True, False], ids=["named", "unnamed"])


def rates(
    expected_hz: float, publications: list[Publication], publishers: int, end_s: float
) -> list[tuple[float, float | None]]:
    """The time and the rate of each poll."""
    meter = RateEstimator(expected_hz, 3.0)
    depth = min(DEPTH_MOST, PER_PUBLISHER * publishers)
    found = []
    for now_s, samples in polls(publications, START_S, end_s, depth):
        listening = Listening(publishers, several=publishers > 1, complete=len(samples) < depth)
        found.append((now_s, meter.update(now_s, samples, listening).hz))
    return found


@NAMED
@pytest.mark.parametrize("both", [(0.2, 0.2), (10.0, 0.2), (10.0, 0.5), (200.0, 0.2), (0.1, 0.02)], ids=str)
def test_the_rate_is_known_beside_a_slow_publisher(both: tuple[float, float], *, named: bool) -> None:
    """It once became unknown for a second at each message of the slow one, or was never known."""
    slowest_s = 1 / min(both)
    end_s = START_S + 20 * slowest_s
    fast, slow = (b"1", b"2") if named else (None, None)
    publications = [
        *even(both[0], START_S, end_s - START_S, writer=fast),
        *even(both[1], START_S + 0.5 / both[1], end_s - START_S, first=700, writer=slow),
    ]
    found = rates(sum(both), publications, 2, end_s)
    later = [hz for now_s, hz in found if now_s > START_S + 4 * slowest_s]
    assert later and None not in later
    assert all(hz == pytest.approx(sum(both), rel=0.06) for hz in later)


@pytest.mark.parametrize("both", [(10.0, 10.0), (10.0, 0.2), (0.2, 0.2), (2.0, 1.0)], ids=str)
@pytest.mark.parametrize("apart_s", [0.0, 0.6, 30.0])
def test_no_rate_is_too_low_while_a_publisher_begins(both: tuple[float, float], apart_s: float) -> None:
    """Until the rate of the second one is known, that of the first is not the rate of the topic."""
    first = even(both[0], START_S, 120.0, writer=b"1")
    second = even(both[1], START_S + apart_s, 120.0 - apart_s, writer=b"2")
    joined_s = second[0].received_s
    found = rates(sum(both), first + second, 2, START_S + 110.0)
    for now_s, hz in found:
        if now_s >= joined_s:
            assert hz is None or hz > 0.9 * sum(both), now_s
    assert found[-1][1] == pytest.approx(sum(both), rel=0.01)


def test_no_rate_is_too_low_while_one_of_two_publishers_is_restarted() -> None:
    """The new one has another identity; both are listed until the lease of the killed one ends."""
    publications = (
        even(10.0, START_S, 60.0, writer=b"1")
        + even(10.0, START_S + 0.03, 20.0, writer=b"2")
        + even(10.0, START_S + 20.23, 39.0, writer=b"3")
    )
    found = rates(20.0, publications, 3, START_S + 59.0)
    assert all(hz is None or hz > 18.0 for _, hz in found)
    assert found[-1][1] == pytest.approx(20.0, rel=0.01)


def test_a_single_message_of_another_publisher_does_not_hide_the_rate() -> None:
    """A tool publishes once and remains."""
    publications = [*even(10.0, START_S, 60.0, writer=b"1"), *even(1.0, START_S + 20.0, 1.0, writer=b"2")]
    found = rates(10.0, publications, 2, START_S + 59.0)
    assert sum(hz is None for now_s, hz in found if now_s > START_S + 20.0) <= 16
    assert found[-1][1] == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize("paused_s", [4.0, 0.5], ids=["silent meanwhile", "quickly"])
def test_a_restarted_slow_publisher_has_its_rate_soon(paused_s: float) -> None:
    """The killed one is listed for up to 20 s more; its rate must not hide that of the new one, nor be added to it."""
    back_s = START_S + 60.0 + paused_s
    publications = even(1.0, START_S, 60.0, writer=b"1") + even(1.0, back_s, 40.0, writer=b"2")
    meter, depth = RateEstimator(1.0, 3.0), 2 * PER_PUBLISHER
    for now_s, samples in polls(publications, START_S, back_s + 40.0, depth):
        fact = meter.update(now_s, samples, Listening(2, several=False, complete=len(samples) < depth))
        assert fact.hz is None or fact.hz < 1.1
        if now_s >= back_s + 5.0:
            assert fact.hz == pytest.approx(1.0), now_s
    assert fact.restarts == 1


@pytest.mark.parametrize("apart_s", [0.3, 1.7, 2.6])
def test_two_slow_publishers_of_one_node_are_not_a_restart(apart_s: float) -> None:
    """One message of the second one looks as if it had replaced the first one, until that publishes again."""
    first = even(0.2, START_S, 120.0, writer=b"1")
    second = even(0.2, START_S + apart_s, 120.0 - apart_s, writer=b"2")
    meter, depth = RateEstimator(0.4, 3.0), 2 * PER_PUBLISHER
    for now_s, samples in polls(first + second, START_S, START_S + 119.0, depth):
        fact = meter.update(now_s, samples, Listening(2, several=False, complete=len(samples) < depth))
        assert fact.hz is None or fact.hz > 0.36, now_s
    assert (fact.restarts, fact.hz) == (0, pytest.approx(0.4, rel=0.05))
