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
ABANDONED = 4
"""A sequence that none of so many later frames on its link continues is over: a restart has begun another one."""
MAX_LINKS = 16


class FrameSequences:
    """By link: the newest number of each sequence, and how many frames of others came since; that of the last frame first."""

    def __init__(self) -> None:
        self._newest: dict[str, list[tuple[int, int]]] = {}

    def add(self, frame: int, link: str, *, known: bool) -> bool:
        """Take the number of a frame; whether it shows a second sender. known: the same frame was received before."""
        newest = self._newest.get(link)
        if newest is None:
            if len(self._newest) < MAX_LINKS:
                self._newest[link] = [(frame, 0)]
            return False
        if (newest[0][0] - frame) % 256 <= REORDERED:
            newest[0] = (frame, 0)
            return not known
        steps = [(frame - last) % 256 for last, _ in newest]
        continued = min(range(len(steps)), key=steps.__getitem__)
        returns = continued > 0 and steps[continued] <= CONTINUES
        if steps[continued] <= CONTINUES:
            del newest[continued]
        others = [(last, age + 1) for last, age in newest if age < ABANDONED]
        self._newest[link] = [(frame, 0), *others]
        return returns
