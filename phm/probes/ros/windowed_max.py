"""The largest of recent numbers, in constant memory."""

from __future__ import annotations

from collections import deque

BUCKETS = 10


class WindowedMax:
    """The largest number of the last `least_s` seconds, or up to a tenth longer. Times must not go back."""

    def __init__(self, least_s: float) -> None:
        self._bucket_s = least_s / BUCKETS
        self._buckets: deque[tuple[float, float]] = deque(maxlen=BUCKETS + 1)

    def add(self, number: float, now_s: float) -> None:
        buckets = self._buckets
        if buckets and now_s - buckets[-1][0] < self._bucket_s:
            began_s, most = buckets[-1]
            if number > most:
                buckets[-1] = (began_s, number)
            return
        buckets.append((now_s, number))
        while now_s - buckets[0][0] >= self._bucket_s * (BUCKETS + 1):
            buckets.popleft()

    def clear(self) -> None:
        self._buckets.clear()

    @property
    def most(self) -> float | None:
        """None when nothing was added, or nothing since `clear`."""
        return max(number for _, number in self._buckets) if self._buckets else None
