"""The bus: bounded, counted, and without blocking."""

from __future__ import annotations

import threading

import pytest

from phm import testing
from phm.core.bus import REPORTED_S, Bus
from phm.core.clock import SystemClock
from phm.core.model import Event, Note, ReportStarted, Stamp
from tests.fakes.until import until

AT = Stamp(0.0, 0.0)
LIMIT_S = 60.0


def note(text: str) -> Note:
    return Note(AT, "PHM", text)


def test_events_arrive_in_order_and_only_of_requested_kinds() -> None:
    """A subscriber gets the kinds that it named, in the order of publishing."""
    bus, seen = Bus(SystemClock()), []
    bus.subscribe("log", seen.append, kinds=(Note,))
    bus.publish(ReportStarted(AT, 1))
    for text in "abc":
        bus.publish(note(text))
    bus.close(LIMIT_S)
    assert [event.text for event in seen if isinstance(event, Note)] == ["a", "b", "c"]
    assert len(seen) == 3


def test_a_slow_subscriber_delays_no_other_and_loses_the_oldest_events() -> None:
    """Publishing never waits, losses are counted, and the newest event matters more than the oldest."""
    bus, gate, seen = Bus(SystemClock()), threading.Event(), []

    def slow(event: Event) -> None:
        gate.wait(LIMIT_S)
        seen.append(event)

    bus.subscribe("slow", slow, size=3)
    bus.publish(note("first"))
    until(lambda: not bus._subscriptions[0]._queue, "an empty queue")
    for number in range(10):
        bus.publish(note(str(number)))
    assert bus.dropped() == {"slow": 7}
    gate.set()
    bus.close(LIMIT_S)
    assert [event.text for event in seen if isinstance(event, Note)] == ["first", "7", "8", "9"]


def test_with_a_key_the_newest_event_of_each_key_is_kept() -> None:
    """Recovery never misses the current state of a fault."""
    bus, gate, seen = Bus(SystemClock()), threading.Event(), []

    def slow(event: Event) -> None:
        gate.wait(LIMIT_S)
        seen.append(event)

    bus.subscribe("recovery", slow, key=lambda event: event.text[0] if isinstance(event, Note) else "")
    bus.publish(note("x"))
    until(lambda: not bus._subscriptions[0]._queue, "an empty queue")
    for text in ("a1", "b1", "a2", "a3"):
        bus.publish(note(text))
    gate.set()
    bus.close(LIMIT_S)
    assert [event.text for event in seen if isinstance(event, Note)] == ["x", "b1", "a3"]


def test_a_subscriber_that_raises_is_counted_and_continues() -> None:
    """A reporter is a plug-in: its errors affect only itself and are visible."""
    bus, seen = Bus(SystemClock()), []

    def handler(event: Event) -> None:
        seen.append(event)
        raise OSError("disk gone")

    bus.subscribe("bad", handler)
    bus.publish(note("a"))
    bus.publish(note("b"))
    bus.close(LIMIT_S)
    assert len(seen) == 2
    assert bus.problems() == ("bad: OSError: disk gone",)


class Unprintable(Exception):
    def __str__(self) -> str:
        raise IndexError


@pytest.mark.parametrize("error", [SystemExit(3), Unprintable()])
def test_nothing_that_a_subscriber_raises_ends_its_thread(error: BaseException) -> None:
    """A plug-in that calls `sys.exit` would otherwise receive nothing more, and no problem would be reported."""
    bus, seen = Bus(SystemClock()), []

    def handler(event: Event) -> None:
        seen.append(event)
        raise error

    bus.subscribe("bad", handler)
    bus.publish(note("a"))
    bus.publish(note("b"))
    bus.close(LIMIT_S)
    assert len(seen) == 2
    assert type(error).__name__ in bus.problems()[0]


def test_ticks_come_every_period_without_events() -> None:
    """The heartbeat of a reporter does not depend on events."""
    clock = testing.FakeClock()
    bus, ticks = Bus(clock), []
    bus.subscribe("beat", lambda event: None, tick=lambda: ticks.append(clock.mono()), period_s=2.0)
    for count in (1, 2, 3):
        until(lambda count=count: len(ticks) == count, "the next event")  # type: ignore[misc]
        clock.wait_for_sleepers(1, LIMIT_S)
        clock.advance(2.0)
    bus.close()


def test_a_problem_that_is_over_is_not_reported_for_long() -> None:
    """Otherwise one lost event keeps the companion computer at WARN until PHM is restarted, and hides what follows."""
    clock, gate, failing = testing.FakeClock(), threading.Event(), [True]
    bus = Bus(clock)

    def handler(event: Event) -> None:
        gate.wait(LIMIT_S)
        if failing.pop():
            raise ValueError("once")

    bus.subscribe("app", handler, size=1)
    for number in range(3):
        bus.publish(note(str(number)))
    failing.insert(0, False)
    gate.set()
    until(lambda: bus.problems() == ("app: ValueError: once",), "the error")
    assert "app" in bus.dropped()
    clock.advance(REPORTED_S + 1)
    assert (bus.problems(), bus.dropped()) == ((), {})
    assert bus.queues()["app"][1] > 0
    bus.close(LIMIT_S)
