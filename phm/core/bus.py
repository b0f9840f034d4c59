"""Event bus: a bounded queue and a thread for each subscriber.

`publish` never blocks. A full queue drops its oldest event and counts it. A subscription with a `key` keeps the newest event of
each key instead, so the subscriber never misses the current state.
"""

from __future__ import annotations

import logging
import threading
import traceback
from collections.abc import Callable, Hashable

from phm.core import threads
from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.core.model import Event

logger = logging.getLogger(__name__)

REPORTED_S = 60.0
"""How long an error of a subscriber, or the loss of an event, is reported as a problem of PHM. One that works again has none."""

Handler = Callable[[Event], None]


class Subscription:
    """One subscriber: its queue and thread. Errors of the handler are logged and counted."""

    def __init__(
        self,
        name: str,
        handler: Handler,
        clock: Clock,
        *,
        kinds: tuple[type, ...] = (),
        size: int = 1000,
        key: Callable[[Event], Hashable] | None = None,
        tick: Callable[[], None] | None = None,
        period_s: float | None = None,
    ) -> None:
        self.name, self.kinds = name, kinds
        self._handler, self._clock = handler, clock
        self._tick, self._period_s = tick, period_s
        self._queue: BoundedQueue[Event] = BoundedQueue(clock, size, key=key)
        self._closing = False
        self.errors = 0
        self.last_error = ""
        self.failed_at = float("-inf")
        self._thread = threading.Thread(target=self._loop, name=f"phm-bus-{name}", daemon=True)
        threads.start(self._thread)

    @property
    def dropped(self) -> int:
        return self._queue.dropped

    @property
    def dropped_at(self) -> float:
        return self._queue.dropped_at

    @property
    def waiting(self) -> int:
        return len(self._queue)

    def put(self, event: Event) -> None:
        if not self.kinds or isinstance(event, self.kinds):
            self._queue.put(event)

    def close(self, timeout_s: float) -> bool:
        """Process the queued events, then end. False if the handler did not finish in time."""
        self._closing = True
        self._queue.wake()
        return threads.join(self._thread, timeout_s)

    def _loop(self) -> None:
        due = self._clock.mono() if self._period_s is not None else None
        while True:
            event = self._queue.next()
            if event is not None:
                self._guarded(lambda event=event: self._handler(event))  # type: ignore[misc]
            elif self._closing:
                return
            now = self._clock.mono()
            if due is not None and self._tick is not None and self._period_s is not None and now >= due:
                self._guarded(self._tick)
                due = max(due + self._period_s, now)
            if event is None:
                self._queue.wait(None if due is None else max(0.0, due - self._clock.mono()))

    def _guarded(self, call: Callable[[], None]) -> None:
        try:
            call()
        except (
            BaseException
        ) as error:  # a reporter may be a plug-in that raises anything, SystemExit included: others go on
            self.errors += 1
            words = "".join(traceback.format_exception_only(error)).strip()  # also for one whose text cannot be made
            self.last_error, self.failed_at = f"{self.name}: {words}", self._clock.mono()
            if self.errors in (1, 10, 100) or self.errors % 1000 == 0:
                logger.exception("subscriber %s failed (%d times)", self.name, self.errors)


class Bus:
    """All subscriptions. Subscribing is allowed at any time."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._subscriptions: tuple[Subscription, ...] = ()

    def subscribe(
        self,
        name: str,
        handler: Handler,
        *,
        kinds: tuple[type, ...] = (),
        size: int = 1000,
        key: Callable[[Event], Hashable] | None = None,
        tick: Callable[[], None] | None = None,
        period_s: float | None = None,
    ) -> Subscription:
        """`kinds`: event classes taken (all when empty). `key`: keep the newest event per key, drop none."""
        subscription = Subscription(
            name, handler, self._clock, kinds=kinds, size=size, key=key, tick=tick, period_s=period_s
        )
        self._subscriptions = (*self._subscriptions, subscription)
        return subscription

    def publish(self, event: Event) -> None:
        for subscription in self._subscriptions:
            subscription.put(event)

    def dropped(self) -> dict[str, int]:
        """How many events were dropped, by subscriber, where that happened in the last REPORTED_S."""
        now = self._clock.mono()
        return {entry.name: entry.dropped for entry in self._subscriptions if now - entry.dropped_at <= REPORTED_S}

    def queues(self) -> dict[str, tuple[int, int]]:
        """How many events wait, and how many were dropped, by subscriber."""
        return {entry.name: (entry.waiting, entry.dropped) for entry in self._subscriptions}

    def problems(self) -> tuple[str, ...]:
        """The newest error of each subscriber that has failed in the last REPORTED_S."""
        now = self._clock.mono()
        return tuple(entry.last_error for entry in self._subscriptions if now - entry.failed_at <= REPORTED_S)

    def close(self, timeout_s: float = 2.0) -> None:
        """Deliver queued events, within `timeout_s` in total."""
        end = self._clock.mono() + timeout_s
        for subscription in self._subscriptions:
            subscription.close(max(0.05, end - self._clock.mono()))
