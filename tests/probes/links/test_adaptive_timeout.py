"""When a sender of heartbeats counts as lost before its timeout: synthetic traces with one heartbeat per second."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator

import pytest

from phm.probes.adaptive_timeout import LEARN_S, STEP_S, STEPS, UNEVEN_S, AdaptiveTimeout

BOUND_S = 10.0
POLL_S = 0.5


def steady(chance: random.Random) -> Iterator[float]:
    """Late by up to 50 ms."""
    yield from (count + 0.05 * chance.random() for count in range(3600))


def jittery(chance: random.Random) -> Iterator[float]:
    """Each late by up to 0.9 s, as on an overloaded machine."""
    yield from (count + 0.9 * chance.random() for count in range(3600))


def late_by_a_second(chance: random.Random) -> Iterator[float]:
    """Regular, and occasionally a heartbeat is one second late: the sender did not get the CPU."""
    yield from (count + 0.05 * chance.random() + (1.0 if chance.random() < 0.01 else 0.0) for count in range(3600))


def lossy(share: float) -> Callable[[random.Random], Iterator[float]]:
    """This share of the heartbeats gets lost independently."""

    def made(chance: random.Random) -> Iterator[float]:
        yield from (at for at in steady(chance) if chance.random() >= share)

    return made


def bursts(share: float, length: float) -> Callable[[random.Random], Iterator[float]]:
    """This share gets lost, `length` of them in a row on average."""

    def made(chance: random.Random) -> Iterator[float]:
        bad = False
        for at in steady(chance):
            stays, begins = 1.0 - 1.0 / length, share / (1.0 - share) / length
            bad = chance.random() < (stays if bad else begins)
            if not bad:
                yield at

    return made


def false_alarms(heartbeats: Iterator[float]) -> int:
    """Count pauses that were taken for a loss although the sender returned within the configured timeout."""
    cadence, last, found = AdaptiveTimeout(BOUND_S), None, 0
    for at in heartbeats:
        if last is not None and at > last:
            looks = (last + POLL_S * count for count in range(1, int((min(at, last + BOUND_S) - last) / POLL_S) + 1))
            found += any(cadence.overdue(look) for look in looks)
        cadence.heartbeat(at)
        last = at
    return found


@pytest.mark.parametrize(
    "trace",
    [steady, jittery, late_by_a_second, lossy(0.01), lossy(0.05), lossy(0.2), bursts(0.2, 3.0), bursts(0.1, 4.0)],
    ids=["steady", "jittery", "late", "lossy 1 %", "lossy 5 %", "lossy 20 %", "bursts 20 %", "bursts 10 %"],
)
def test_an_hour_raises_no_false_alarm(trace: Callable[[random.Random], Iterator[float]]) -> None:
    """With any jitter and loss from the beginning: eight hours, each with another random seed."""
    assert [false_alarms(trace(random.Random(seed))) for seed in range(8)] == [0] * 8


def learned(cadence: AdaptiveTimeout, heartbeats: int = int(LEARN_S) + 3, period_s: float = 1.0) -> float:
    for count in range(heartbeats):
        cadence.heartbeat(count * period_s)
    return (heartbeats - 1) * period_s


def test_a_lost_regular_sender_is_detected_early() -> None:
    """Two and a half seconds after its last heartbeat, with one per second; one lost heartbeat is not a loss."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence)
    assert cadence.due_s() == UNEVEN_S
    assert not cadence.overdue(last + 2.1)
    assert cadence.overdue(last + 2.6)


def test_no_limit_is_below_the_minimum() -> None:
    """A ground station gets more time than an autopilot."""
    cadence = AdaptiveTimeout(BOUND_S, 5.0)
    last = learned(cadence)
    assert not cadence.overdue(last + 4.9)
    assert cadence.overdue(last + 5.1)


def test_a_sender_that_was_not_received_for_long_has_no_separate_limit() -> None:
    """Only the configured timeout applies."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence, int(LEARN_S) - 5)
    assert cadence.due_s() is None
    assert not cadence.overdue(last + 9.9)


def test_a_lost_heartbeat_raises_the_limit_for_a_while() -> None:
    """And two lost in a row disable it; after an hour that is forgotten."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence)
    cadence.heartbeat(last + 2.0)
    assert cadence.due_s() == pytest.approx(4.4)
    cadence.heartbeat(last + 5.0)
    assert cadence.due_s() is None
    for count in range(1, int(STEP_S * (STEPS + 2))):
        cadence.heartbeat(last + 5.0 + count)
    assert cadence.due_s() == UNEVEN_S


def test_a_slow_sender_has_the_configured_timeout() -> None:
    """One heartbeat every five seconds."""
    cadence = AdaptiveTimeout(BOUND_S)
    learned(cadence, 60, 5.0)
    assert cadence.due_s() is None


def test_a_limit_above_the_configured_timeout_is_ignored() -> None:
    """The configured timeout is the upper bound."""
    cadence = AdaptiveTimeout(3.5)
    last = learned(cadence)
    cadence.heartbeat(last + 1.7)
    assert cadence.due_s() is None


def test_an_outage_does_not_raise_the_limit() -> None:
    """A silence beyond the configured timeout was reported as a fault; the next one is detected as early."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence)
    cadence.heartbeat(last + 30.0)
    assert cadence.due_s() == UNEVEN_S


def test_an_overdue_sender_stays_overdue_until_its_next_heartbeat() -> None:
    """Even if its link is closed or reopened in the meantime."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence)
    assert cadence.overdue(last + 2.6)
    cadence.broke(last + 3.0)
    assert cadence.overdue(None)
    assert cadence.overdue(last + 3.1)
    cadence.heartbeat(last + 4.0)
    assert not cadence.overdue(last + 4.1)


def test_a_closed_link_is_not_a_pause_of_the_sender() -> None:
    """The link was closed for a moment: silence counts from then on, and the earlier pause is forgotten, too."""
    cadence = AdaptiveTimeout(BOUND_S)
    last = learned(cadence)
    cadence.heartbeat(last + 2.4)
    cadence.broke(last + 4.0)
    assert cadence.due_s() == UNEVEN_S
    assert not cadence.overdue(last + 6.0)
    assert cadence.overdue(last + 6.6)
    cadence.heartbeat(last + 6.6)
    assert cadence.due_s() == UNEVEN_S
