"""What waits to leave by one MAVLink endpoint: heartbeats on time, the rest by class and within the link's budget."""

from __future__ import annotations

import threading
from typing import Any

from phm.core.clock import Clock
from phm.transport.priority import LinkBudget, MessageCount, MessagePriority, QueuedMessage

HEARTBEAT = 0
OUTBOX_AGE_S = 30.0
"""What could not be sent for so long because the link was lost is no news any more; the ground gets the full state when
it is back. While the link is open nothing grows too old: newer words of the same key replace older ones."""


class SendQueue:
    """Any thread puts, the endpoint's takes. Never blocks, bounded by the budget's own cap."""

    def __init__(self, clock: Clock, bytes_s: float | None = None) -> None:
        self._clock = clock
        self._budget = LinkBudget(bytes_s, clock.mono())
        self._heartbeat: QueuedMessage | None = None
        self._number = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._budget.waiting + (self._heartbeat is not None)

    @property
    def counts(self) -> dict[MessagePriority, MessageCount]:
        return self._budget.counts

    @property
    def dropped(self) -> int:
        return sum(count.dropped for count in self._budget.counts.values())

    def put(
        self,
        message: Any,
        size: int,
        kind: MessagePriority = MessagePriority.TRANSITION,
        key: str = "",
        urgency: int = 0,
    ) -> None:
        """size: bytes of its frame. key: a newer one with the same key makes this superfluous; empty for none."""
        with self._lock:
            self._number += 1
            now = self._clock.mono()
            # Not `message.id`: STATUSTEXT has a field of that name, which hides the message's number.
            if message.get_msgId() == HEARTBEAT:
                # A newer heartbeat replaces one that still waits: both together would say less.
                self._heartbeat = QueuedMessage("", MessagePriority.TRANSITION, size, message, put_at=now)
                return
            self._budget.put(QueuedMessage(key or f"#{self._number}", kind, size, message, urgency, now))

    def take(self) -> QueuedMessage | None:
        """What leaves next, or None when nothing may leave now."""
        with self._lock:
            now = self._clock.mono()
            if self._heartbeat is not None:
                item, self._heartbeat = self._heartbeat, None
                self._budget.heartbeat(item.size, now)
                return item
            return self._budget.next(now)

    def give_back(self, item: QueuedMessage) -> None:
        """What was taken could not be sent: it is first again, unless newer words of its key wait by now."""
        with self._lock:
            if item.message.get_msgId() == HEARTBEAT:
                self._heartbeat = self._heartbeat or item
            else:
                self._budget.give_back(item)

    def expire(self) -> None:
        """The link is open again: forget what is no news any more."""
        with self._lock:
            self._budget.expire(self._clock.mono() - OUTBOX_AGE_S)

    def txbuf(self, percent: int) -> None:
        """A RADIO_STATUS came by this link."""
        with self._lock:
            self._budget.flow.txbuf(percent, self._clock.mono())

    def set_agent_count(self, agents: int, *, leads: bool) -> None:
        """So many agents share the link, and whether this one speaks for them."""
        with self._lock:
            self._budget.agents, self._budget.leads = agents, leads

    def slowed(self) -> float:
        """1 to 10: by how much the radio slows this link down now."""
        with self._lock:
            return self._budget.flow.factor(self._clock.mono())
