"""How far a measured rate may be off by the publisher's own unevenness."""

from __future__ import annotations

import math
from collections import deque

FADE_S, FADE_WINDOWS = 60.0, 20
"""What was seen counts for about so long, or so many windows where that is longer."""
_ALIKE = 0.7
"""Windows are compared when one is at least this share of the other."""


class RateUncertainty:
    """Compares each rate with the one before its window began: both are of the same publisher, and share no sample.

    So jitter, bursts and stalls are seen as what they do to the rate. A rate that really changes is one difference
    among many, and hardly matters.
    """

    def __init__(self, window_s: float) -> None:
        self._fade_s = max(FADE_S, FADE_WINDOWS * window_s)
        self._past: deque[tuple[float, float, float]] = deque(maxlen=1000)
        self._seen_s = 0.0
        self._square = 0.0
        """Mean of half the squared difference, times the window: for one twice as long the square is half."""

    def add(self, now_s: float, hz: float, window_s: float) -> None:
        """A look: the rate as measured over the last `window_s`."""
        past = self._past
        since_s = now_s - past[-1][0] if past else 0.0
        while len(past) > 1 and now_s - past[1][0] >= window_s:
            past.popleft()
        if past and now_s - past[0][0] >= window_s and past[0][2] >= _ALIKE * window_s:
            self._seen_s += since_s
            share = min(1.0, since_s / min(self._fade_s, self._seen_s)) if since_s else 0.0
            self._square += share * ((hz - past[0][1]) ** 2 / 2 * window_s - self._square)
        past.append((now_s, hz, window_s))

    def forget(self) -> None:
        """What comes does not continue what was."""
        self._past.clear()

    def error_hz(self, window_s: float) -> float | None:
        """Standard deviation of a rate that is measured over `window_s`; None until two windows have been compared."""
        return math.sqrt(self._square / window_s) if self._seen_s and window_s else None
