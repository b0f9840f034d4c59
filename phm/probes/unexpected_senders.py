"""Heartbeats with our autopilot's ids on links that do not lead to it: another vehicle's, or forged. Pure.

A ground station's program may pass our own autopilot's frames on to us. Those have its time since boot, and are left out.
"""

from __future__ import annotations

from collections import deque

ENOUGH, WINDOW_S = 2, 30.0
"""So many heartbeats within this time are reported."""
SAME_BOOT_S = 3.0
"""Times since boot that differ by less are of one autopilot: frames are late on a radio."""


class UnexpectedSenders:
    """Not thread-safe. Of the link by which a heartbeat came last."""

    def __init__(self) -> None:
        self._heartbeats: deque[float] = deque(maxlen=ENOUGH)
        self._link = ""
        self._booted: dict[str, float] = {}
        """By link: when the sender was started, on our clock."""

    def heartbeat(self, now: float, link: str) -> None:
        self._link = link
        self._heartbeats.append(now)

    def booted(self, now: float, boot_s: float, link: str) -> None:
        """It says that it has been running for so long."""
        self._booted[link] = now - boot_s

    def link(self, now: float, own_boot_s: float | None) -> str:
        """By which another autopilot is received; empty: by none. own_boot_s: for how long ours has been running."""
        if len(self._heartbeats) < ENOUGH or now - self._heartbeats[0] > WINDOW_S:
            return ""
        booted = self._booted.get(self._link)
        if booted is not None and own_boot_s is not None and abs(now - own_boot_s - booted) < SAME_BOOT_S:
            return ""
        return self._link
