"""Traffic of a link over time."""

from __future__ import annotations

import pytest

from phm.facts import LinkFact
from phm.probes.link_stats import LOSS_S, MIN_FRAMES, LinkStats
from phm.transport.mavlink_traffic import Traffic
from phm.transport.serial_errors import SerialErrorCount

BASE = LinkFact("ground", open=True)


def test_the_traffic_is_unknown_at_first() -> None:
    """One sample makes no rate."""
    flow = LinkStats((7, 193))
    assert flow.fact(0.0, BASE) == BASE
    flow.sample(10.0, Traffic(bytes_in=100))
    fact = flow.fact(10.2, BASE)
    assert (fact.rx_s, fact.frames_s, fact.line) == (None, None, None)
    assert fact.rx_age_s == pytest.approx(0.2)


def test_rates_are_means_over_the_last_seconds() -> None:
    """Bytes, frames, false frame starts and line errors per second; the age shows a pause."""
    flow = LinkStats((7, 193))
    for second in range(20):
        moving = min(second, 10)
        flow.sample(
            float(second),
            Traffic(100 * moving, 10 * second, 5 * moving, moving, line=SerialErrorCount(2 * second, 0, 0)),
        )
        if second == 9:
            fact = flow.fact(9.0, BASE)
            assert (fact.rx_s, fact.tx_s, fact.frames_s, fact.bad_s) == (100.0, 10.0, 5.0, 1.0)
            assert fact.line is not None
            assert fact.line.framing_s == 2.0
            assert fact.rx_age_s == 0.0
    fact = flow.fact(19.0, BASE)
    assert (fact.rx_s, fact.tx_s, fact.rx_age_s) == (0.0, 10.0, 9.0)


def test_samples_may_be_offered_at_any_rate() -> None:
    """The thread of each endpoint does so."""
    flow = LinkStats((7, 193))
    for step in range(2000):
        flow.sample(step * 0.01, Traffic(bytes_in=step))
    assert len(flow._totals) < 20
    assert flow.fact(20.0, BASE).rx_s == pytest.approx(100.0, rel=0.01)


def test_loss_is_reported_per_sender_over_a_window() -> None:
    """Of the last half minute, and only with enough frames; PHM's own echo does not count as a sender."""
    flow = LinkStats((7, 193))
    counts = {(1, 1): (0, 0), (255, 190): (0, 0), (7, 193): (0, 0)}
    for second in range(int(LOSS_S) + 70):
        lost = min(60, second)
        counts = {(1, 1): (9 * second, lost), (255, 190): (second // 4, 0), (7, 193): (second, 0)}
        flow.sample(float(second), Traffic(bytes_in=second, senders=counts))
        if second == 50:
            early = flow.fact(50.0, BASE).senders
            assert [(one.system, one.component) for one in early] == [(1, 1), (255, 190)]
            assert early[0].loss_percent == pytest.approx(10.0)
            assert early[1].loss_percent is None
            assert early[1].frames < MIN_FRAMES
    (pilot, ground) = flow.fact(100.0, BASE).senders
    assert pilot.loss_percent == 0.0
    assert (pilot.age_s, ground.age_s) == (1.0, 4.0)


def test_a_sender_that_was_forgotten_and_returned_has_lost_nothing() -> None:
    """Its counters start again."""
    flow = LinkStats((7, 193))
    flow.sample(0.0, Traffic(senders={(1, 1): (500, 90)}))
    flow.sample(5.0, Traffic(senders={(1, 1): (30, 0)}))
    (sender,) = flow.fact(5.0, BASE).senders
    assert sender.loss_percent is None
    assert sender.frames == 0
