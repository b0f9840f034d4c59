"""News to one consumer: a bounded queue that drops the oldest and counts, so that nobody who is slow delays the station."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from phm.core.clock import Clock
from phm.gcs.events import News

SIZE = 5000


@dataclass(frozen=True, slots=True)
class Item:
    """number: counts up by one. line: the news as JSON, without the line's end."""

    number: int
    news: News
    line: bytes


class Outlet:
    """One thread puts, one takes."""

    def __init__(self, clock: Clock, size: int = SIZE) -> None:
        self._clock, self._size = clock, size
        self._items: deque[Item] = deque()
        self._lock = threading.Lock()
        self._ready = threading.Event()
        self.dropped = 0

    def put(self, item: Item) -> None:
        """Never waits."""
        with self._lock:
            self._items.append(item)
            if len(self._items) > self._size:
                self._items.popleft()
                self.dropped += 1
            self._ready.set()

    def take(self, timeout_s: float) -> list[Item]:
        """All that waits; when nothing does, what comes within the time."""
        self._clock.wait(self._ready, timeout_s)
        with self._lock:
            found = list(self._items)
            self._items.clear()
            self._ready.clear()
        return found

    def wake(self) -> None:
        """Have `take` come back at once."""
        self._ready.set()
