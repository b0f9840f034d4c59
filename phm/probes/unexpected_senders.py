"""Heartbeats with our autopilot's ids on links that do not lead to it: another vehicle's, or forged. Pure.

A ground station may forward our own autopilot's frames. Those have its time since boot, and are ignored.
"""

from __future__ import annotations

from collections import deque

ENOUGH, WINDOW_S = 2, 30.0
"""This many heartbeats within this time are reported."""
SAME_BOOT_S = 3.0
"""Times since boot that differ by less belong to one autopilot: frames are delayed by radios."""


class UnexpectedSenders:
    """Not thread-safe. For the link on which a heartbeat arrived last."""

    def __init__(self) -> None:
        self._heartbeats: deque[float] = deque(maxlen=ENOUGH)
        self._link = ""
        self._booted: dict[str, float] = {}
        """By link: when the sender started, on our clock."""

    def heartbeat(self, now: float, link: str) -> None:
        self._link = link
        self._heartbeats.append(now)

    def booted(self, now: float, boot_s: float, link: str) -> None:
        """Record the time since boot that it reports."""
        self._booted[link] = now - boot_s

    def link(self, now: float, own_boot_s: float | None) -> str:
        """The link on which another autopilot is received; empty: none. own_boot_s: how long ours has been running."""
        if len(self._heartbeats) < ENOUGH or now - self._heartbeats[0] > WINDOW_S:
            return ""
        booted = self._booted.get(self._link)
        if booted is not None and own_boot_s is not None and abs(now - own_boot_s - booted) < SAME_BOOT_S:
            return ""
        return self._link
