"""`phm.core.bounded_queue`: producers never wait, and what is dropped is counted."""

from __future__ import annotations

import threading

from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import SystemClock
from phm.testing import FakeClock


def test_a_full_queue_drops_its_oldest_item() -> None:
    """`put` returns True, and the loss is counted."""
    queue: BoundedQueue[int] = BoundedQueue(FakeClock(), 2)
    assert [queue.put(number) for number in range(4)] == [True] * 4
    assert (queue.take(0.0), queue.dropped, len(queue)) == ([2, 3], 2, 0)


def test_a_full_queue_can_refuse_the_new_item() -> None:
    """With `refuse_new`, `put` returns False, and the loss is counted."""
    queue: BoundedQueue[int] = BoundedQueue(FakeClock(), 2, refuse_new=True)
    assert [queue.put(number) for number in range(4)] == [True, True, False, False]
    assert (queue.take(0.0), queue.dropped) == ([0, 1], 2)


def test_a_new_item_replaces_the_one_with_its_key() -> None:
    """It moves to the end, and nothing counts as dropped."""
    queue: BoundedQueue[str] = BoundedQueue(FakeClock(), 2, key=lambda item: item[0])
    for item in ("a1", "b1", "a2"):
        queue.put(item)
    assert (queue.take(0.0), queue.dropped) == (["b1", "a2"], 0)


def test_items_come_one_by_one_oldest_first() -> None:
    """None when the queue is empty."""
    queue: BoundedQueue[int] = BoundedQueue(FakeClock(), 5)
    queue.put(1)
    queue.put(2)
    assert [queue.next(), queue.next(), queue.next()] == [1, 2, None]


def test_a_waiting_consumer_gets_an_item_when_it_is_put() -> None:
    """It does not wait until its timeout."""
    queue: BoundedQueue[int] = BoundedQueue(SystemClock(), 5)
    found: list[list[int]] = []
    consumer = threading.Thread(target=lambda: found.append(queue.take(10.0)), daemon=True)
    consumer.start()
    queue.put(7)
    consumer.join(60)
    assert found == [[7]]


def test_wake_ends_the_wait_without_an_item() -> None:
    """The consumer gets an empty list."""
    queue: BoundedQueue[int] = BoundedQueue(SystemClock(), 5)
    found: list[list[int]] = []
    consumer = threading.Thread(target=lambda: found.append(queue.take(10.0)), daemon=True)
    consumer.start()
    queue.wake()
    consumer.join(60)
    assert found == [[]]
