"""`phm.transport.send_queue`: what waits for an endpoint, what is replaced, and what is dropped."""

from __future__ import annotations

from typing import Any

from phm.testing import FakeClock
from phm.transport.priority import MAX_WAITING
from phm.transport.send_queue import OUTBOX_AGE_S, SendQueue
from tests.fakes.mavlink import heartbeat, text


def drain(outbox: SendQueue) -> list[Any]:
    return [item.message for item in iter(outbox.take, None)]


def put(outbox: SendQueue, message: Any) -> None:
    outbox.put(message, 63)


def test_a_full_outbox_drops_its_oldest_and_counts() -> None:
    """What is newest matters most, and what was lost is known."""
    outbox = SendQueue(FakeClock())
    for number in range(MAX_WAITING + 5):
        put(outbox, text(f"line {number}"))
    assert outbox.dropped == 5
    assert [message.text for message in drain(outbox)] == [f"line {number}" for number in range(5, MAX_WAITING + 5)]


def test_what_could_not_be_sent_is_first_again() -> None:
    """A network that is gone for a moment costs no line and changes no order."""
    outbox = SendQueue(FakeClock())
    put(outbox, text("first"))
    put(outbox, text("second"))
    item = outbox.take()
    assert item is not None
    outbox.give_back(item)
    assert [message.text for message in drain(outbox)] == ["first", "second"]


def test_waiting_heartbeats_are_replaced_and_old_lines_expire() -> None:
    """After an outage the ground gets one heartbeat, first, and no outdated line."""
    clock = FakeClock()
    outbox = SendQueue(clock)
    put(outbox, text("old"))
    put(outbox, heartbeat(1))
    clock.advance(OUTBOX_AGE_S + 1)
    put(outbox, text("new"))
    put(outbox, heartbeat(2))
    outbox.expire()
    first, second = drain(outbox)
    assert (first.custom_mode, second.text) == (2, "new")
    assert outbox.dropped == 1


def test_lines_wait_for_the_budget_and_heartbeats_do_not() -> None:
    clock = FakeClock()
    outbox = SendQueue(clock, 10.0)
    for number in range(20):
        put(outbox, text(f"line {number}"))
    burst = drain(outbox)
    assert 0 < len(burst) < 20
    put(outbox, heartbeat(1))
    assert [message.get_type() for message in drain(outbox)] == ["HEARTBEAT"]
    clock.advance(1000.0)
    assert drain(outbox)[0].text == f"line {len(burst)}"
