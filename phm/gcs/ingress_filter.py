"""What does not reach the fleet's state: more frames than one sender may send, and copies by another link. Pure."""

from __future__ import annotations

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.rate_limiter import RateLimiter

RATE, BURST = 50.0, 200.0
"""Frames of one sender, per second and in a burst: an agent sends one or two, and its full state in one go."""
NEW_RATE, NEW_BURST = 20.0, 300.0
"""New senders, per second and in a burst: a swarm of 250 may appear together, but not repeatedly."""
MAX_SENDERS = 1024
COPY_S = 5.0
MAX_COPIES = 2048


class IngressFilter:
    """A sender that floods a link loses its own frames only, and one without the key none of those that are signed. Not thread-safe."""

    def __init__(self) -> None:
        self._senders = RateLimiter(RATE, BURST, MAX_SENDERS)
        self._new = {signed: RateLimiter(NEW_RATE, NEW_BURST) for signed in (False, True)}
        self._frames: DuplicateFilter[bytes, str] = DuplicateFilter(MAX_COPIES, COPY_S)
        self.refused = 0
        """Number of frames that exceeded a limit."""

    def allow(self, sender: tuple[int, int], now: float, *, signed: bool = False) -> bool:
        """Whether one more frame of a sender (system, component) is within the limits. signed: with a valid signature."""
        key = (*sender, signed)
        allowed = (key in self._senders or self._new[signed].allow(now)) and self._senders.allow(now, key)
        self.refused += not allowed
        return allowed

    def is_copy(self, frame: bytes, link: str, now: float) -> bool:
        """Whether the same frame arrived by another link within COPY_S."""
        first = self._frames.get(frame, now)
        if first not in (None, link):
            return True
        self._frames.add(frame, link, now)
        return False
