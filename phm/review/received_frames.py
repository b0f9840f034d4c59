"""When which heartbeats were received or sent, in bounded memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phm.review.events import LATEST_S

MOST_FRAMES = 200_000
MOST_TIMES = 1000
"""Of one frame, and of one line."""


class ReceivedFrames(dict[tuple[int, int, int], list[float]]):
    """Times by system, component and frame number, on the clock of the run."""

    def take(self, frames: Sequence[tuple[int, int, int, float]]) -> None:
        """frames: as in `Event.frames`."""
        for system, component, number, mono in frames[:MOST_TIMES]:
            if len(self) < MOST_FRAMES and 0.0 <= mono < LATEST_S:
                times = self.setdefault((system, component, number), [])
                if len(times) < MOST_TIMES:
                    times.append(mono)

    def merge(self, other: Mapping[tuple[int, int, int], list[float]]) -> None:
        for frame, times in other.items():
            self[frame] = sorted({*self.get(frame, []), *times})
