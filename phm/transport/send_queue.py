"""Messages that wait for one MAVLink endpoint: heartbeats on time, the rest by priority and within the link's budget."""

from __future__ import annotations

import threading
from collections.abc import Set
from typing import Any

from phm.core.clock import Clock
from phm.transport.priority import LinkBudget, MessageCount, MessagePriority, QueuedMessage

HEARTBEAT = 0
OUTBOX_AGE_S = 30.0
"""Messages that could not be sent for this long because the link was lost are dropped; the ground gets the full state when
it is back. While the link is open, a newer one with the same key replaces a message, and one that is not true any more waits."""


class SendQueue:
    """Any thread puts, the endpoint's takes. Never blocks, bounded by the budget's own cap."""

    def __init__(self, clock: Clock, bytes_s: float | None = None) -> None:
        self._clock = clock
        self._budget = LinkBudget(bytes_s, clock.mono())
        self._heartbeat: QueuedMessage | None = None
        self._number = 0
        self._lock = threading.Lock()

    def __len__(self) -> int:
        with self._lock:
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
        only_while: tuple[str, ...] = (),
        *,
        only_replace: bool = False,
    ) -> None:
        """size: bytes of its frame. key: a newer one with the same key makes this superfluous; empty for none. only_while:
        see `QueuedMessage`. only_replace: it is sent only in place of one that waits.
        """
        with self._lock:
            if only_replace and not self._budget.waits(key):
                return
            self._number += 1
            now = self._clock.mono()
            # Not `message.id`: STATUSTEXT has a field of that name, which hides the message's number.
            if message.get_msgId() == HEARTBEAT:
                # A newer heartbeat replaces one that still waits: both together would say less.
                self._heartbeat = QueuedMessage("", MessagePriority.TRANSITION, size, message, put_at=now)
                return
            self._budget.put(QueuedMessage(key or f"#{self._number}", kind, size, message, urgency, now, only_while))

    def set_true(self, names: Set[str]) -> None:
        """See `LinkBudget.set_true`."""
        with self._lock:
            self._budget.set_true(names)

    def take(self) -> QueuedMessage | None:
        """The next message to send, or None when nothing may be sent now."""
        with self._lock:
            now = self._clock.mono()
            if self._heartbeat is not None:
                item, self._heartbeat = self._heartbeat, None
                self._budget.heartbeat(item.size, now)
                return item
            return self._budget.next(now)

    def give_back(self, item: QueuedMessage) -> None:
        """It could not be sent: it is first again, unless a newer message with its key waits."""
        with self._lock:
            if item.message.get_msgId() == HEARTBEAT:
                self._heartbeat = self._heartbeat or item
            else:
                self._budget.give_back(item)

    def expire(self) -> None:
        """The link is open again: drop outdated messages."""
        with self._lock:
            self._budget.expire(self._clock.mono() - OUTBOX_AGE_S)

    def txbuf(self, percent: int) -> None:
        """Take over a RADIO_STATUS that arrived on this link."""
        with self._lock:
            self._budget.flow.txbuf(percent, self._clock.mono())

    def set_agent_count(self, agents: int, *, leads: bool) -> None:
        """Set how many agents share the link, and whether this one is the leader of the swarm."""
        with self._lock:
            self._budget.agents, self._budget.leads = agents, leads

    def slowed(self) -> float:
        """1 to 10: by how much the radio slows this link down now."""
        with self._lock:
            return self._budget.flow.factor(self._clock.mono())
