"""The meter: rates from sequence numbers and publication times."""

from __future__ import annotations

import pytest

from phm.probes.ros.meter import Meter
from phm.probes.ros.track import Sample

TICK_S = 0.25


def flow(
    meter: Meter, hz: float, start_s: float, seconds: float, *, first: int = 1, writer: bytes | None = None,
    offset_s: float = 0.0, numbered: bool = True,
) -> float:  # fmt: skip
    """Feed what a reader with a queue of one sees of an even publisher, until `start_s + seconds`.

    Not numbered: a deep queue hands over everything. offset_s: the publisher's clock against ours.
    """
    last = 0
    ticks = round(seconds / TICK_S)
    for tick in range(1, ticks + 1):
        now_s = start_s + tick * TICK_S
        newest = int(tick * TICK_S * hz)
        for count in range(last + 1, newest + 1) if not numbered else [newest] * (newest > last):
            stamp_ns = int((start_s + offset_s + count / hz) * 1e9)
            meter.add(Sample(first + count if numbered else None, stamp_ns, now_s, writer))
        last = newest
    return start_s + ticks * TICK_S


@pytest.mark.parametrize("hz", [0.5, 1.0, 7.3, 10.0, 200.0, 1000.0])
def test_the_rate_is_exact_at_any_speed(hz: float) -> None:
    """One sample a tick is enough, from half a hertz to a kilohertz."""
    meter = Meter(hz, 3.0)
    end_s = flow(meter, hz, 100.0, 20.0)
    assert meter.fact(end_s, 1).hz == pytest.approx(hz, rel=1e-3)


def test_without_numbers_all_samples_are_counted() -> None:
    """Middleware without sequence numbers: a deep queue is drained, and the rate is as exact."""
    meter = Meter(40.0, 3.0)
    end_s = flow(meter, 40.0, 100.0, 10.0, numbered=False)
    assert meter.fact(end_s, 1).hz == pytest.approx(40.0, rel=1e-3)


def test_two_samples_close_together_are_no_rate_yet() -> None:
    """Below a second of publication time the rate is not known, not wrong."""
    meter = Meter(10.0, 3.0)
    end_s = flow(meter, 10.0, 100.0, 0.5)
    assert meter.fact(end_s, 1).hz is None
    assert meter.fact(end_s, 1).silent_s == 0.0


def test_before_the_first_sample_nothing_is_known() -> None:
    """A topic never heard has neither rate nor silence."""
    fact = Meter(10.0, 3.0).fact(100.0, 1)
    assert (fact.hz, fact.silent_s, fact.samples) == (None, None, 0)


@pytest.mark.parametrize(("hz", "limit_s"), [(10.0, 3.0), (0.5, 6.0)])
def test_silence_is_three_periods_or_the_configured_time(hz: float, limit_s: float) -> None:
    """Up to the limit the last rate stands; beyond it the rate is 0.0 and the silence is counted."""
    meter = Meter(hz, 3.0)
    end_s = flow(meter, hz, 100.0, 20.0)
    assert meter.fact(end_s + limit_s - 0.01, 1).hz == pytest.approx(hz, rel=1e-3)
    silent = meter.fact(end_s + limit_s + 0.01, 1)
    assert silent.hz == 0.0
    assert silent.silent_s == pytest.approx(limit_s + 0.01)


def test_after_a_silence_the_rate_is_measured_anew() -> None:
    """The silence is not averaged into the rate of what follows."""
    meter = Meter(10.0, 3.0)
    end_s = flow(meter, 10.0, 100.0, 5.0)
    meter.fact(end_s + 8.0, 1)
    end_s = flow(meter, 10.0, end_s + 8.0, 5.0, first=51)
    assert meter.fact(end_s, 1).hz == pytest.approx(10.0, rel=1e-3)


def test_a_restarted_publisher_is_measured_anew() -> None:
    """Numbers that fall are a new life of the publisher, neither a negative rate nor ambiguity."""
    meter = Meter(10.0, 3.0)
    end_s = flow(meter, 10.0, 100.0, 10.0, first=5000)
    end_s = flow(meter, 20.0, end_s, 5.0)
    fact = meter.fact(end_s, 1)
    assert fact.problem == ""
    assert fact.hz == pytest.approx(20.0, rel=1e-3)


@pytest.mark.parametrize("step_s", [-3600.0, 3600.0])
def test_a_clock_that_was_set_does_not_bend_the_rate(step_s: float) -> None:
    """A jump of the publisher's clock begins a new window."""
    meter = Meter(10.0, 3.0)
    end_s = flow(meter, 10.0, 100.0, 5.0)
    end_s = flow(meter, 10.0, end_s, 5.0, first=51, offset_s=step_s)
    assert meter.fact(end_s, 1).hz == pytest.approx(10.0, rel=1e-3)


def test_several_publishers_are_ambiguous() -> None:
    """Numbers are counted by each publisher: with two of them, and no identity, there is no rate."""
    meter = Meter(10.0, 3.0)
    end_s = flow(meter, 10.0, 100.0, 5.0)
    fact = meter.fact(end_s, 2)
    assert fact.hz is None
    assert fact.problem == "ambiguous: 2 publishers"


def test_two_publishers_in_one_node_are_told_by_their_numbers() -> None:
    """Discovery shows one node, but the numbers keep falling."""
    meter = Meter(10.0, 3.0)
    for tick in range(20):
        number = 5000 + tick if tick % 2 else 100 + tick
        meter.add(Sample(number, int((100 + tick * TICK_S) * 1e9), 100 + tick * TICK_S))
    assert "ambiguous" in meter.fact(105.0, 1).problem


def test_publishers_with_an_identity_are_added_up() -> None:
    """Where the middleware names the writer, two publishers give the sum of their rates."""
    meter = Meter(10.0, 3.0)
    flow(meter, 10.0, 100.0, 5.0, writer=b"a")
    end_s = flow(meter, 5.0, 100.0, 5.0, writer=b"b")
    assert meter.fact(end_s, 2).hz == pytest.approx(15.0, rel=1e-3)
