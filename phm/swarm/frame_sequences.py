"""Whether the frames of one id come from two senders, by their sequence numbers. Pure.

A sender counts its frames modulo 256. Two senders with one id alternate between two sequences; a restart begins a new sequence and
never returns to the one before.
"""

from __future__ import annotations

REORDERED = 8
"""Frames may be reordered by this many, or arrive by two links: a smaller step back counts only if the frame was not received
before. Two agents that were switched on together, from copies of one card, are never further apart."""
CONTINUES = 32
"""A frame continues a sequence if its number is at most this much higher: a sender sends fewer others between two heartbeats."""
SEQUENCES = 3
"""How many sequences are remembered for each link: those of two senders, and one that a restart has begun."""
MAX_LINKS = 16


class FrameSequences:
    """The newest number of each sequence, by link, the sequence of the last frame first."""

    def __init__(self) -> None:
        self._newest: dict[str, list[int]] = {}

    def add(self, frame: int, link: str, *, known: bool) -> bool:
        """Take the number of a frame; whether it shows a second sender. known: the same frame was received before."""
        newest = self._newest.get(link)
        if newest is None:
            if len(self._newest) < MAX_LINKS:
                self._newest[link] = [frame]
            return False
        if (newest[0] - frame) % 256 <= REORDERED:
            newest[0] = frame
            return not known
        place = next((place for place, last in enumerate(newest) if (frame - last) % 256 <= CONTINUES), None)
        if place is not None:
            del newest[place]
        newest.insert(0, frame)
        del newest[SEQUENCES:]
        return bool(place)
