"""A queue between threads whose producers never wait: when it is full, an item is dropped and counted."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from phm.core.clock import Clock

T = TypeVar("T")


class BoundedQueue(Generic[T]):
    """Holds at most `size` items, oldest first. Thread-safe; one thread may wait.

    key: a new item replaces the one with the same key, and moves to the end. refuse_new: when the queue is full, drop the
    new item instead of the oldest one.
    """

    def __init__(
        self, clock: Clock, size: int, *, key: Callable[[T], Hashable] | None = None, refuse_new: bool = False
    ) -> None:
        self._clock, self._size, self._key, self._refuse_new = clock, size, key, refuse_new
        self._items: OrderedDict[Hashable, T] = OrderedDict()
        self._number = 0
        self._lock = threading.Lock()
        self._ready = threading.Event()
        self.dropped = 0
        self.dropped_at = float("-inf")

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> bool:
        """Add an item; False when it was dropped. Never waits."""
        with self._lock:
            self._number += 1
            key = self._number if self._key is None else self._key(item)
            self._items.pop(key, None)
            full = len(self._items) >= self._size
            if full:
                self.dropped, self.dropped_at = self.dropped + 1, self._clock.mono()
            if full and self._refuse_new:
                return False
            if full:
                self._items.popitem(last=False)
            self._items[key] = item
            self._ready.set()
        return True

    def wait(self, timeout_s: float | None) -> None:
        """Wait until there is an item, `wake` is called, or the time is over."""
        self._clock.wait(self._ready, timeout_s)

    def next(self) -> T | None:
        """Remove and return the oldest item; None when the queue is empty."""
        with self._lock:
            if self._items:
                return self._items.popitem(last=False)[1]
            self._ready.clear()
            return None

    def take(self, timeout_s: float) -> list[T]:
        """Remove and return all items, oldest first; when there are none, wait for one first."""
        self.wait(timeout_s)
        with self._lock:
            items = list(self._items.values())
            self._items.clear()
            self._ready.clear()
        return items

    def wake(self) -> None:
        """End the wait."""
        self._ready.set()
