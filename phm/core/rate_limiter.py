"""Token buckets: one, and one for each of many keys. Pure; callers pass monotonic time in seconds."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass


@dataclass(slots=True)
class TokenBucket:
    """`tokens` are available; the bucket was last filled at `at`. Not thread-safe."""

    tokens: float
    at: float

    def refill(self, now: float, rate: float, burst: float) -> None:
        """Add `rate` tokens for each second since the last call, up to `burst`."""
        earned = (now - self.at) * rate if now > self.at else 0.0
        self.tokens, self.at = min(burst, self.tokens + earned), now

    def take(self, tokens: float = 1.0) -> bool:
        """Take tokens if enough are available. Returns whether they were."""
        if tokens > self.tokens:
            return False
        self.tokens -= tokens
        return True


class RateLimiter:
    """`rate` events per second for each key, and bursts of up to `burst`. Not thread-safe.

    At most `max_keys` are remembered; the least recently used one is forgotten first, and starts with a full bucket.
    """

    def __init__(self, rate: float, burst: float, max_keys: int = 1) -> None:
        self._rate, self._burst, self._max_keys = rate, burst, max_keys
        self._buckets: OrderedDict[Hashable, TokenBucket] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._buckets

    def __len__(self) -> int:
        return len(self._buckets)

    def allow(self, now: float, key: Hashable = None) -> bool:
        """Whether one more event of this key is within the limit."""
        bucket = self._buckets.pop(key, None) or TokenBucket(self._burst, now)
        self._buckets[key] = bucket
        if len(self._buckets) > self._max_keys:
            self._buckets.popitem(last=False)
        bucket.refill(now, self._rate, self._burst)
        return bucket.take()

    def left(self, now: float, key: Hashable = None) -> float:
        """How many events of this key are within the limit now, `burst` when there were none. Counts as none itself."""
        bucket = self._buckets.get(key) or TokenBucket(self._burst, now)
        bucket.refill(now, self._rate, self._burst)
        return bucket.tokens
