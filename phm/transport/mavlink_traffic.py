"""Counts the traffic of one MAVLink endpoint: bytes, frames, and for each sender the gaps in its sequence numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from phm.transport.serial_errors import SerialErrorCount

MAX_SENDERS = 64
"""Any sender can invent system ids; of too many, those with the fewest frames are forgotten."""
RESTART_GAP = 64
"""A larger gap counts as a restarted sender or a long pause, not as loss: the number has eight bits."""
LATE = 16
"""A frame that is less far behind was reordered, or arrived by two paths."""


@dataclass(slots=True)
class SenderStats:
    """Counts since its first frame. `lost` may go down: a reordered frame is not lost."""

    frames: int = 0
    lost: int = 0
    sequence: int = 0


class SenderTable:
    """Counters by system and component. The endpoint's thread writes; `now` may be called from any."""

    def __init__(self) -> None:
        self._of: dict[tuple[int, int], SenderStats] = {}

    def __contains__(self, sender: tuple[int, int]) -> bool:
        return sender in self._of

    def receive(self, system: int, component: int, sequence: int) -> None:
        """Record a frame."""
        key = (system, component)
        sender = self._of.get(key)
        if sender is None:
            if len(self._of) >= MAX_SENDERS:
                del self._of[min(self._of, key=lambda other: self._of[other].frames)]
            self._of[key] = SenderStats(1, 0, sequence)
            return
        behind = (sender.sequence - sequence) & 0xFF
        if behind == 0:
            return
        sender.frames += 1
        if behind <= LATE:
            sender.lost = max(0, sender.lost - 1)
            return
        gap = (sequence - sender.sequence - 1) & 0xFF
        if gap < RESTART_GAP:
            sender.lost += gap
        sender.sequence = sequence

    def now(self) -> dict[tuple[int, int], tuple[int, int]]:
        """The number of frames and lost frames of each sender."""
        # The interpreter copies a dict with such keys in one step.
        return {key: (sender.frames, sender.lost) for key, sender in dict(self._of).items()}


@dataclass(frozen=True, slots=True)
class Traffic:
    """Of one endpoint since PHM's start; only `line` is reset when a serial port is reopened."""

    bytes_in: int = 0
    bytes_out: int = 0
    frames: int = 0
    bad: int = 0
    senders: Mapping[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    line: SerialErrorCount | None = None
    frame_bytes: int = 0
    """Of the frames in `frames`."""
    verified: int = 0
    """The part of `frames` whose checksum was computed."""
