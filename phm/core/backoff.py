"""Pauses between attempts that grow exponentially. Seconds throughout."""

from __future__ import annotations

MAX_DOUBLINGS = 60
"""Enough for any pair of pauses, and far below what a float can hold."""


def pause_s(failures: int, first_s: float, longest_s: float) -> float:
    """Pause after this many failures in a row: `first_s` after the first, then twice as long each time, up to `longest_s`."""
    return min(first_s * 2.0 ** min(max(0, failures - 1), MAX_DOUBLINGS), longest_s)


class Backoff:
    """Counts failures in a row. Not thread-safe."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s, self._longest_s = first_s, longest_s
        self._failures = 0

    @property
    def pause_s(self) -> float:
        """The pause after one more failure."""
        return pause_s(self._failures + 1, self._first_s, self._longest_s)

    def next_s(self) -> float:
        """Count a failure; the pause after it."""
        pause = self.pause_s
        self._failures = min(self._failures + 1, MAX_DOUBLINGS)
        return pause

    def reset(self) -> None:
        """An attempt succeeded: start with the first pause again."""
        self._failures = 0
