"""The samples of one publisher of a topic, and the rate at which it publishes."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

SHORTEST_S = 1.0
"""Below this span of publication time the jitter of two stamps is too large a share of it."""
JUMP_S = 1.0
"""Stamps that disagree with the time between two looks by more than this tell a clock that was set."""
FALLS, FALLS_S = 3, 10.0
"""A number that falls is a restarted publisher; this many falls within this time are two publishers."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One look. sequence: None where the middleware has none. source_ns: publisher's clock. at_s: ours, monotonic."""

    sequence: int | None
    source_ns: int
    at_s: float
    writer: bytes | None = None
    """Identity of the publisher, where the middleware tells it (from Kilted on)."""


class Track:
    """The samples of one publisher within the window.

    Invariant: sequence numbers and source times of what is kept rise strictly; whatever breaks that
    (restart, a clock that was set) starts the window anew.
    """

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._kept: deque[Sample] = deque(maxlen=10_000)
        self._counted = 0
        self._falls: deque[float] = deque(maxlen=FALLS)
        self.last_s: float | None = None
        self.seen = 0

    def add(self, sample: Sample) -> None:
        if sample.sequence is None:
            # No sequence numbers: the deep queue hands over every sample, so counting gives them.
            self._counted += 1
            sample = Sample(self._counted, sample.source_ns, sample.at_s, sample.writer)
        if self._kept and not self._continues(self._kept[-1], sample):
            self._kept.clear()
        self._kept.append(sample)
        while sample.at_s - self._kept[0].at_s > self._window_s and len(self._kept) > 2:
            self._kept.popleft()
        self.last_s = sample.at_s
        self.seen += 1

    def _continues(self, last: Sample, sample: Sample) -> bool:
        assert last.sequence is not None and sample.sequence is not None
        if sample.sequence <= last.sequence:
            self._falls.append(sample.at_s)
            return False
        published_s = (sample.source_ns - last.source_ns) / 1e9
        return published_s > 0 and abs(published_s - (sample.at_s - last.at_s)) <= max(JUMP_S, self._window_s / 3)

    def forget(self) -> None:
        """Begin anew: what comes after a silence must not be averaged with it."""
        self._kept.clear()

    def mixed(self, now_s: float) -> bool:
        """Whether these numbers can only be those of several publishers."""
        return len(self._falls) == FALLS and now_s - self._falls[0] <= FALLS_S

    @property
    def span_s(self) -> float:
        return (self._kept[-1].source_ns - self._kept[0].source_ns) / 1e9 if self._kept else 0.0

    @property
    def hz(self) -> float | None:
        if self.span_s < SHORTEST_S:
            return None
        first, last = self._kept[0].sequence, self._kept[-1].sequence
        assert first is not None and last is not None
        return (last - first) / self.span_s
