"""`phm.transport.send_queue`: which messages wait for an endpoint, are replaced, or are dropped."""

from __future__ import annotations

from typing import Any
from unittest.mock import MagicMock

from phm.testing import FakeClock
from phm.transport.priority import MAX_WAITING
from phm.transport.send_queue import OUTBOX_AGE_S, SendQueue
from tests.fakes.mavlink import heartbeat, text


def drain(queue: SendQueue) -> list[Any]:
    return [item.message for item in iter(queue.take, None)]


def put(queue: SendQueue, message: Any) -> None:
    queue.put(message, 63)


def test_a_full_queue_drops_its_oldest_and_counts() -> None:
    """The newest messages matter most, and the number of lost ones is known."""
    queue = SendQueue(FakeClock())
    for number in range(MAX_WAITING + 5):
        put(queue, text(f"line {number}"))
    assert queue.dropped == 5
    assert [message.text for message in drain(queue)] == [f"line {number}" for number in range(5, MAX_WAITING + 5)]


def test_an_unsent_message_returns_to_the_front() -> None:
    """A network that fails for a moment loses no line and changes no order."""
    queue = SendQueue(FakeClock())
    put(queue, text("first"))
    put(queue, text("second"))
    item = queue.take()
    assert item is not None
    queue.give_back(item)
    assert [message.text for message in drain(queue)] == ["first", "second"]


def test_waiting_heartbeats_are_replaced_and_old_lines_expire() -> None:
    """After an outage the ground gets one heartbeat, first, and no outdated line."""
    clock = FakeClock()
    queue = SendQueue(clock)
    put(queue, text("old"))
    put(queue, heartbeat(1))
    clock.advance(OUTBOX_AGE_S + 1)
    put(queue, text("new"))
    put(queue, heartbeat(2))
    queue.expire()
    first, second = drain(queue)
    assert (first.custom_mode, second.text) == (2, "new")
    assert queue.dropped == 1


def test_lines_wait_for_the_budget_and_heartbeats_do_not() -> None:
    """The ground takes missing heartbeats for a lost agent."""
    clock = FakeClock()
    queue = SendQueue(clock, 10.0)
    for number in range(20):
        put(queue, text(f"line {number}"))
    burst = drain(queue)
    assert 0 < len(burst) < 20
    put(queue, heartbeat(1))
    assert [message.get_type() for message in drain(queue)] == ["HEARTBEAT"]
    clock.advance(1000.0)
    assert drain(queue)[0].text == f"line {len(burst)}"


def test_the_number_of_waiting_messages_is_counted_while_no_thread_changes_them() -> None:
    """Counting looks at each message, and the endpoint's thread takes them."""
    queue = SendQueue(FakeClock())
    put(queue, text("line"))
    queue._lock = MagicMock()
    assert len(queue) == 1
    assert queue._lock.__enter__.called
