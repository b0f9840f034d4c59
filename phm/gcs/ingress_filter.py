"""What is kept away from the store: more than one sender may say, and frames that came before by another link. Pure."""

from __future__ import annotations

from collections import OrderedDict

RATE, BURST = 50.0, 200.0
"""Frames a second of one sender, and at once: an agent sends one or two, and its full state in one go."""
NEW_RATE, NEW_BURST = 20.0, 300.0
"""New senders: a swarm of 250 may appear at once, and not again and again."""
MAX_SENDERS = 1024
COPY_S = 5.0
MAX_COPIES = 2048


class Meter:
    """Who floods a link crowds out himself alone. Not thread-safe."""

    def __init__(self) -> None:
        self._senders: OrderedDict[tuple[int, int], tuple[float, float]] = OrderedDict()
        self._new = (NEW_BURST, float("-inf"))
        self.refused = 0

    def allow(self, sender: tuple[int, int], now: float) -> bool:
        """Whether one more frame of a sender (system, component) is taken."""
        held = self._senders.pop(sender, None)
        if held is None:
            self._new, admitted = _take(self._new, now, NEW_RATE, NEW_BURST)
            if not admitted:
                self.refused += 1
                return False
            held = (BURST, now)
        self._senders[sender], taken = _take(held, now, RATE, BURST)
        if len(self._senders) > MAX_SENDERS:
            self._senders.popitem(last=False)
        self.refused += not taken
        return taken


class Copies:
    """The very same frame by another link, shortly after: it says nothing new. Not thread-safe."""

    def __init__(self) -> None:
        self._seen: OrderedDict[bytes, tuple[str, float]] = OrderedDict()

    def copy(self, frame: bytes, link: str, now: float) -> bool:
        seen = self._seen.get(frame)
        if seen is not None and seen[0] != link and now - seen[1] <= COPY_S:
            return True
        self._seen.pop(frame, None)
        self._seen[frame] = (link, now)
        if len(self._seen) > MAX_COPIES:
            self._seen.popitem(last=False)
        return False


def _take(bucket: tuple[float, float], now: float, rate: float, burst: float) -> tuple[tuple[float, float], bool]:
    credit, at = bucket
    credit = min(burst, credit + max(0.0, now - at) * rate)
    return ((credit - 1.0, now), True) if credit >= 1.0 else ((credit, now), False)
