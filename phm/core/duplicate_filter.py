"""Recognizes recent duplicates, with limited memory. Pure; callers pass monotonic time in seconds."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class DuplicateFilter(Generic[K, V]):
    """Keys with a value each, remembered for `keep_s` seconds. Not thread-safe.

    At most `size` keys are remembered; the one that was added first is forgotten first.
    """

    def __init__(self, size: int, keep_s: float = float("inf")) -> None:
        self._size, self._keep_s = size, keep_s
        self._seen: OrderedDict[K, tuple[V, float]] = OrderedDict()

    def __len__(self) -> int:
        return len(self._seen)

    def get(self, key: K, now: float = 0.0) -> V | None:
        """The value with which the key was added last; None if it was not added, or too long ago."""
        value, at = self._seen.get(key, (None, now))
        return value if now - at <= self._keep_s else None

    def add(self, key: K, value: V, now: float = 0.0) -> None:
        """Remember the key from now on."""
        self._seen.pop(key, None)
        self._seen[key] = (value, now)
        if len(self._seen) > self._size:
            self._seen.popitem(last=False)
