"""How much of a link PHM may use, and which message is sent first. Pure; callers pass the time.

A 64 kbit/s SiK or RFD900 radio guarantees 3170 bytes per second in each direction, and PHM may use 5 % of it for the
entire swarm. Each agent gets an equal share, saves up for a burst, and slows down when RADIO_STATUS reports that the
radio's buffer fills. A fault must not wait for a refresh, so messages have priorities, and all but changes leave room in what
was saved up.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Set
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

from phm.core.rate_limiter import TokenBucket

RADIO_BYTES_S = 3170.0
SHARE = 0.05
SWARM_BYTES_S = RADIO_BYTES_S * SHARE
BURST_S = 20.0
BURST_MIN = 400.0
"""Bytes that an agent may always save up: the full state for a ground station that appears, in a swarm of any size."""
LINE_ROOM = 80.0
"""Bytes that everything but changes leaves for the line of a new fault: 63 at most, 76 with a signature."""
ROUTINE_ROOM = BURST_MIN / 2
"""Bytes that routine messages leave for several faults, and for an answer to a command. Near the upper end of each size of
swarm they need more than an agent's share, and would otherwise use up all that was saved."""
REST, LEADER = 0.2, 0.2
TXBUF_STALE_S = 5.0
SLOWEST = 10.0
MAX_WAITING = 256
UNSIGNED_LAST = 9
"""Urgency of answers to unsigned senders on a link with signing."""
SIZES: tuple[tuple[int, float, float], ...] = ((8, 2.0, 10.0), (30, 5.0, 60.0), (100, 15.0, 150.0), (250, 40.0, 300.0))
"""Up to this many agents: seconds between heartbeats, seconds between refreshes. Unsigned, with views and the leader's
lines, up to 30 agents stay within SHARE of the radio and 100 within 6 % of it (`scripts/bench mavlink`); each heartbeat has
the status."""


class MessagePriority(IntEnum):
    """The lowest is sent first. Heartbeats have none: they are sent on time."""

    TRANSITION = 0
    """A change: a fault, its end, a recommended action."""
    STATE = 1
    """The full state for a ground station that has just appeared."""
    SWARM = 2
    """Views and digests."""
    REFRESH = 3
    """Periodic messages, and texts of a failure that change all the time."""
    REQUEST = 4
    """Requested messages: details, ONBOARD_COMPUTER_STATUS. They take turns with routine messages (`LinkBudget`)."""


ROUTINE = frozenset({MessagePriority.SWARM, MessagePriority.REFRESH})


@dataclass(frozen=True, slots=True)
class QueuedMessage:
    """One message that waits. A newer one with the same key takes its place. size: bytes on the wire."""

    key: str
    kind: MessagePriority
    size: int
    message: Any
    urgency: int = 0
    """Within a priority the lowest is sent first: MAV_SEVERITY. Of equals the oldest."""
    put_at: float = 0.0
    only_while: tuple[str, ...] = ()
    """It leaves only while all of these are true (`LinkBudget.set_true`). Until then it waits, and delays no other message."""


@dataclass(slots=True)
class MessageCount:
    """Counters of one priority: `coalesced` were replaced by newer ones while they waited, `dropped` were never sent."""

    sent: int = 0
    coalesced: int = 0
    dropped: int = 0
    bytes: int = 0


def default_periods(agents: int) -> tuple[float, float]:
    """Seconds between heartbeats and between refreshes for a swarm of this many agents."""
    for size, heartbeat_s, refresh_s in SIZES:
        if agents <= size:
            return heartbeat_s, refresh_s
    return SIZES[-1][1:]


class FlowControl:
    """Slows down while a radio's transmit buffer fills: RADIO_STATUS.txbuf, percent of it that is free."""

    def __init__(self) -> None:
        self._factor, self._received = 1.0, float("-inf")

    def txbuf(self, percent: int, now: float) -> None:
        """A RADIO_STATUS arrived. The steps are those of ArduPilot's own streams: a large one below 20, a small one
        below 50."""
        if now - self._received > TXBUF_STALE_S:
            self._factor = 1.0
        self._received = now
        if percent < 20:
            self._factor *= 2.0
        elif percent < 50:
            self._factor *= 1.25
        elif percent > 95:
            self._factor /= 2.0
        elif percent > 90:
            self._factor /= 1.25
        self._factor = min(max(self._factor, 1.0), SLOWEST)

    def factor(self, now: float) -> float:
        """1 to 10: the factor by which to slow down; 1 without a recent RADIO_STATUS."""
        return self._factor if now - self._received <= TXBUF_STALE_S else 1.0


@dataclass(slots=True)
class LinkBudget:
    """What may be sent on one link now. bytes_s: the share of the entire swarm; None: the link has no limit.

    Heartbeats are never delayed, because silence means a lost agent; their bytes are taken from the rest. At least REST of
    the share remains: where the heartbeats of a large swarm use all of it, faults must still be reported.
    Invariant: over any time t not more than `burst + t * rate` bytes leave besides the heartbeats.

    An answer to a command is sent before routine messages until answers have used ROUTINE_ROOM more bytes than these; then both
    take turns. So an answer does not wait for minutes, and a sender of many commands cannot stop views and refreshes. Answers to
    unsigned senders are not among these: they are last, and leave the room that routine messages leave.
    """

    bytes_s: float | None
    now: float
    agents: int = 1
    leads: bool = False
    """Whether this agent is the leader of the swarm, and has a fifth of the swarm's share for that."""
    flow: FlowControl = field(default_factory=FlowControl)
    counts: dict[MessagePriority, MessageCount] = field(
        default_factory=lambda: {kind: MessageCount() for kind in MessagePriority}
    )
    _beat: tuple[float, float] = (float("-inf"), 0.0)
    """When the last heartbeat was sent, and bytes per second of heartbeats."""
    _credit: TokenBucket = field(init=False)
    """Bytes that were saved for later."""
    _ahead: float = -ROUTINE_ROOM
    """Bytes of answers minus bytes of routine messages. Answers are first while it is not above 0."""
    _waiting: OrderedDict[str, QueuedMessage] = field(default_factory=OrderedDict)
    _true: Set[str] = frozenset()
    """What is true now."""

    def __post_init__(self) -> None:
        self._credit = TokenBucket(self.burst, self.now)

    @property
    def rate(self) -> float:
        """Bytes per second of this agent besides its heartbeats, before the radio slows it down."""
        if self.bytes_s is None:
            return float("inf")
        part = self.bytes_s / max(1, self.agents)
        # The leader's part is not available to others, so that all together stay within the share.
        own = part * (1.0 - LEADER) if self.agents > 1 else part
        return max(own - self._beat[1], part * REST) + (self.bytes_s * LEADER if self.leads else 0.0)

    @property
    def burst(self) -> float:
        return max(BURST_MIN, self.rate * BURST_S)

    def heartbeat(self, size: int, now: float) -> None:
        """A heartbeat of this many bytes was sent."""
        last = self._beat[0]
        self._beat = (now, size / (now - last) if now > last else self._beat[1])

    def set_true(self, names: Set[str]) -> None:
        """What is true now, in place of what was before. What a message says may have become untrue while it waited. It is not
        removed then: its sender does not send it again when it is true again.
        """
        self._true = names

    def put(self, item: QueuedMessage) -> None:
        """Queue a message; it replaces the one with its key. When too many wait, the least important one is dropped."""
        old = self._waiting.get(item.key)
        if old is not None:
            self.counts[old.kind].coalesced += 1
            item = _replacing(old, item)
        self._waiting[item.key] = item
        if len(self._waiting) > MAX_WAITING:
            # What it says becomes true after it was put: it is judged by its importance.
            least = max(
                self._waiting.values(), key=lambda each: (each is not item and not self._may_leave(each), *_order(each))
            )
            del self._waiting[least.key]
            self.counts[least.kind].dropped += 1

    def waits(self, key: str) -> bool:
        """Whether a message with this key waits."""
        return key in self._waiting

    def next(self, now: float) -> QueuedMessage | None:
        """The message to send now, or None. A small message does not pass a more important one that waits for credit."""
        self._credit.refill(now, self.rate / self.flow.factor(now), self.burst)
        item = self._first()
        if item is None or self._credit.tokens - item.size < _room(item):
            return None
        self._credit.take(item.size)
        self._ahead = min(max(self._ahead + _answer_bytes(item), -ROUTINE_ROOM), ROUTINE_ROOM)
        del self._waiting[item.key]
        count = self.counts[item.kind]
        count.sent, count.bytes = count.sent + 1, count.bytes + item.size
        return item

    def _first(self) -> QueuedMessage | None:
        ready = [item for item in self._waiting.values() if self._may_leave(item)]
        least = min(ready, key=_order, default=None)
        if least is None or least.kind not in ROUTINE or self._ahead > 0:
            return least
        return min((item for item in ready if _is_answer(item)), key=_order, default=least)

    def _may_leave(self, item: QueuedMessage) -> bool:
        return all(name in self._true for name in item.only_while)

    def give_back(self, item: QueuedMessage) -> None:
        """It could not be sent. It is first among its equals again, unless a newer one with its key waits."""
        self._credit.tokens = min(self.burst, self._credit.tokens + item.size)
        self._ahead -= _answer_bytes(item)
        count = self.counts[item.kind]
        count.sent, count.bytes = count.sent - 1, count.bytes - item.size
        if item.key in self._waiting:
            count.coalesced += 1
            self._waiting[item.key] = _replacing(item, self._waiting[item.key])
            return
        self._waiting[item.key] = item
        self._waiting.move_to_end(item.key, last=False)

    def expire(self, before: float) -> None:
        """Drop what was put before this time, and could have left."""
        for item in [item for item in self._waiting.values() if item.put_at < before and self._may_leave(item)]:
            del self._waiting[item.key]
            self.counts[item.kind].dropped += 1

    @property
    def waiting(self) -> int:
        """How many messages could leave now, apart from the budget."""
        return sum(self._may_leave(item) for item in self._waiting.values())


def _order(item: QueuedMessage) -> tuple[int, int]:
    return item.kind, item.urgency


def _replacing(old: QueuedMessage, new: QueuedMessage) -> QueuedMessage:
    """The newer message, at least as important as the one that it replaces: what that was about was not sent."""
    if new.kind <= old.kind:
        return new
    return replace(new, kind=old.kind, urgency=min(old.urgency, new.urgency))


def _is_answer(item: QueuedMessage) -> bool:
    """Whether it may be sent before routine messages."""
    return item.kind is MessagePriority.REQUEST and item.urgency < UNSIGNED_LAST


def _answer_bytes(item: QueuedMessage) -> float:
    """By how much it changes `LinkBudget._ahead`."""
    if _is_answer(item):
        return item.size
    return -item.size if item.kind in ROUTINE else 0.0


def _room(item: QueuedMessage) -> float:
    """Bytes that must remain after this message."""
    if item.kind is MessagePriority.TRANSITION:
        return 0.0
    return LINE_ROOM if item.kind is MessagePriority.STATE or _is_answer(item) else ROUTINE_ROOM
