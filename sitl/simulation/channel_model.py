"""One radio link: a queue that is sent at the air data rate, delay, losses, a cut. Pure: the time is a parameter.

A frame enters the transmit buffer entirely or, without space, not at all. It leaves the buffer at the air data rate,
may get lost, and arrives after the delay. While the link is cut nothing leaves the buffer, so it fills up, as in a SiK
radio.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")

SIK_SHARE = 3170 / 8000
"""The share of its air data rate that a SiK pair transfers each way: 64 kbit/s give 3170 bytes/s (docs/reference/mavlink.md)."""
BUFFER_BYTES = 2048
"""Transmit buffer of a SiK radio."""
FOREIGN_BYTES = 64
"""Size of a frame of the foreign traffic of `fill_bps`."""
_LIMITS: Mapping[str, tuple[float, float]] = {
    "loss": (0.0, 1.0),
    "burst": (1.0, 1000.0),
    "delay_s": (0.0, 10.0),
    "rate_bps": (100.0, 1e9),
    "rssi": (0, 254),
    "noise": (0, 254),
    "fill_bps": (0.0, 1e9),
}


@dataclass
class Conditions:
    """The state of a link; see `sitl.swarm.control.LinkEmulatorClient.set` for each field."""

    cut: bool = False
    off: bool = False
    loss: float = 0.0
    burst: float = 1.0
    delay_s: float = 0.03
    rate_bps: float = 64_000.0
    rssi: int = 180
    noise: int = 40
    fill_bps: float = 0.0

    def change(self, values: Mapping[str, Any]) -> None:
        """Set the named fields. Raises ValueError for an unknown name or a value out of range; then nothing is changed."""
        known = {field.name for field in fields(self)}
        for key, value in values.items():
            if key not in known:
                raise ValueError(f"a link has no {key!r}: allowed are {', '.join(sorted(known))}")
            _judge(key, value)
        for key, value in values.items():
            setattr(self, key, value)


def _judge(key: str, value: Any) -> None:
    if key not in _LIMITS:
        if not isinstance(value, bool):
            raise ValueError(f"{key} is {value!r}: allowed are true and false")
        return
    least, most = _LIMITS[key]
    if isinstance(value, bool) or not isinstance(value, int | float) or not least <= value <= most:
        raise ValueError(f"{key} is {value!r}: allowed is {least:g} to {most:g}")


class Losses:
    """Which frames get lost: the share `loss` in the long run, `burst` consecutive ones on average (Gilbert's two-state
    model).
    """

    def __init__(self, chance: random.Random) -> None:
        self._chance, self._bad = chance, False

    def next(self, loss: float, burst: float) -> bool:
        """Whether the next frame is lost."""
        if burst <= 1.0 or loss >= 1.0:
            return self._chance.random() < loss
        leave = 1.0 / burst
        enter = min(1.0, leave * loss / (1.0 - loss))
        self._bad = self._chance.random() < (1.0 - leave if self._bad else enter)
        return self._bad


@dataclass
class _Waiting(Generic[Item]):
    size: int
    item: Item | None
    since: float


class Pipe(Generic[Item]):
    """One direction of a link. `conditions` may change at any time. share: of the air data rate, for this direction."""

    def __init__(
        self,
        conditions: Conditions,
        chance: random.Random,
        *,
        share: float = SIK_SHARE,
        buffer_bytes: int = BUFFER_BYTES,
        filled: bool = False,
    ) -> None:
        self.conditions = conditions
        self.lost = self.full = 0
        """Frames that got lost in the air, and that found no room in the buffer."""
        self._losses = Losses(chance)
        self._share, self._buffer, self._filled = share, buffer_bytes, filled
        self._waiting: deque[_Waiting[Item]] = deque()
        self._held = 0
        self._flying: deque[tuple[float, Item]] = deque()
        self._free_from = 0.0
        self._foreign_from: float | None = None

    @property
    def rate(self) -> float:
        """Bytes a second."""
        return self.conditions.rate_bps / 8 * self._share

    def offer(self, now: float, size: int, item: Item) -> bool:
        """Queue a frame of `size` bytes for the other end; False when there was no space for it."""
        self._drain(now)
        if not self._put(_Waiting(size, item, now)):
            self.full += 1
            return False
        return True

    def arrived(self, now: float) -> list[Item]:
        """The frames that have arrived at the other end since the last call, in order."""
        self._drain(now)
        found = []
        while self._flying and self._flying[0][0] <= now:
            found.append(self._flying.popleft()[1])
        return found

    def free_percent(self, now: float) -> int:
        """The free share of the transmit buffer in percent: RADIO_STATUS.txbuf."""
        self._drain(now)
        return max(0, 100 * (self._buffer - self._held) // self._buffer)

    def next_s(self) -> float | None:
        """The time of the next arrival, as far as it is known; None when nothing is in transit."""
        if self._flying:
            return self._flying[0][0]
        if self._waiting and not self.conditions.cut:
            return self._leaves(self._waiting[0]) + self.conditions.delay_s
        return None

    def clear(self) -> None:
        """The radio loses power and the content of its buffer."""
        self._waiting.clear()
        self._flying.clear()
        self._held = 0
        self._foreign_from = None

    def _put(self, frame: _Waiting[Item]) -> bool:
        if self._held + frame.size > self._buffer:
            return False
        self._waiting.append(frame)
        self._held += frame.size
        return True

    def _leaves(self, frame: _Waiting[Item]) -> float:
        return max(self._free_from, frame.since) + frame.size / self.rate

    def _drain(self, now: float) -> None:
        if self.conditions.cut:
            self._free_from = now
        else:
            self._send(now)
        self._foreign(now)

    def _send(self, now: float) -> None:
        while self._waiting and (gone := self._leaves(self._waiting[0])) <= now:
            frame = self._waiting.popleft()
            self._held -= frame.size
            self._free_from = gone
            if frame.item is None:
                continue
            if self._losses.next(self.conditions.loss, self.conditions.burst):
                self.lost += 1
            else:
                self._flying.append((gone + self.conditions.delay_s, frame.item))

    def _foreign(self, now: float) -> None:
        """Foreign frames arrive evenly; those without space are dropped."""
        if not self._filled or not self.conditions.fill_bps:
            self._foreign_from = None
            return
        every_s = FOREIGN_BYTES * 8 / self.conditions.fill_bps
        came = now if self._foreign_from is None else self._foreign_from
        # After a long pause only as many as fit into the buffer: the others would have been dropped.
        came = max(came, now - every_s * (self._buffer // FOREIGN_BYTES))
        while came <= now:
            self._put(_Waiting(FOREIGN_BYTES, None, came))
            came += every_s
        self._foreign_from = came
