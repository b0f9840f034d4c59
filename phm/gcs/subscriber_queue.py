"""Events for one consumer, who cannot delay the station: a slow one loses the oldest events, which are counted."""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.bounded_queue import BoundedQueue
from phm.core.clock import Clock
from phm.gcs.events import GcsEvent

SIZE = 5000


@dataclass(frozen=True, slots=True)
class QueuedEvent:
    """number: counts up by one. line: the event as JSON, without the line's end."""

    number: int
    event: GcsEvent
    line: bytes


class SubscriberQueue(BoundedQueue[QueuedEvent]):
    """A queue into which one thread puts events and from which one thread takes them."""

    def __init__(self, clock: Clock, size: int = SIZE) -> None:
        super().__init__(clock, size)
