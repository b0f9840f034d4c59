"""Heartbeats of others, as marks by which the clocks of different agents can be compared after the flight.

Every agent logs the same ones: those whose frame number is a multiple of `EACH`. Two agents that received the same frame
received it at the same time, except for delays of the links.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from phm.core.clock import Clock

if TYPE_CHECKING:
    from phm.reporters.base import MavlinkSender

HEARTBEAT_ID = 0
EACH = 8
WRITE_S = 10.0
MOST = 64
"""Frames in one line of the log; of more, the oldest are dropped."""
MOST_SENDERS = 256
AGAIN_S = 5.0
"""The same frame that arrives later than the first one, by another link, does not count."""


class ReceivedHeartbeats:
    """Collects received heartbeats of other senders between two lines of the log. `take` is called by the log's thread,
    `receive` by the links'."""

    def __init__(self, mavlink: MavlinkSender | None, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._frames: list[tuple[int, int, int, float]] = []
        self._newest: dict[tuple[int, int], tuple[int, float]] = {}
        self._written_s = clock.mono()
        if mavlink is not None:
            mavlink.listen(self._receive, (HEARTBEAT_ID,))

    def take(self) -> list[tuple[int, int, int, float]]:
        """System, component, frame number and monotonic second of each; empty until `WRITE_S` have passed."""
        now_s = self._clock.mono()
        if now_s - self._written_s < WRITE_S:
            return []
        self._written_s = now_s
        with self._lock:
            frames, self._frames = self._frames, []
        return frames

    def _receive(self, message: Any, link: str) -> None:
        self.receive(message.get_srcSystem(), message.get_srcComponent(), message.get_seq())

    def receive(self, system: int, component: int, number: int) -> None:
        """A heartbeat with this frame number arrived now, or was sent."""
        if number % EACH:
            return
        sender, now_s = (system, component), self._clock.mono()
        with self._lock:
            last = self._newest.get(sender)
            if last is not None and last[0] == number and now_s - last[1] < AGAIN_S:
                return
            if last is None and len(self._newest) >= MOST_SENDERS:
                del self._newest[min(self._newest, key=lambda other: self._newest[other][1])]
            self._newest[sender] = number, now_s
            self._frames.append((*sender, number, round(now_s, 3)))
            del self._frames[:-MOST]
