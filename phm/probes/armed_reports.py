"""Whether the armed states that the autopilot's heartbeats report can all be of one vehicle. Pure.

One vehicle lands once: armed for a while, then disarmed. Two senders with one identity, one of which may be another vehicle or
forged, contradict each other: on one link the state changes back within seconds, or one link said armed at last and the others
report disarmed. When one of the two falls silent, the rest looks like a landing, and is none.
"""

from __future__ import annotations

from dataclasses import dataclass

from phm.facts.links import REBOOT_SILENCE_S


@dataclass(slots=True)
class _Link:
    """The newest heartbeat of one link. since: when its state was first reported without a change or a silence in between."""

    at: float
    armed: bool
    since: float
    armed_at: float | None
    contradicted: bool = False


class ArmedReports:
    """Not thread-safe. timeout_s: longest pause within a series of heartbeats."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = min(timeout_s, REBOOT_SILENCE_S)
        self._links: dict[str, _Link] = {}
        self.landed: float | None = None
        """When a link last reported disarmed after it had reported nothing but armed for at least the timeout."""

    def heartbeat(self, now: float, armed: bool, link: str) -> None:
        known = self._links.get(link)
        if known is None:
            self._links[link] = _Link(now, armed, now, now if armed else None)
            return
        steady = now - known.at <= self._timeout_s
        if armed and not known.armed and known.armed_at is not None and now - known.armed_at <= self._timeout_s:
            known.contradicted = True
        if steady and known.armed and not armed and known.at - known.since >= self._timeout_s:
            self.landed, known.contradicted = now, False
        if not steady or armed != known.armed:
            known.since = now
        known.at, known.armed = now, armed
        known.armed_at = now if armed else known.armed_at

    def contradicted(self) -> bool:
        """Whether disarmed must not be believed: until a landing was received, however long the reports have agreed since."""
        return any(link.contradicted for link in self._links.values()) or self._vetoed()

    def _vetoed(self) -> bool:
        """Whether a link said armed at last, another one has reported disarmed since, and none of them a landing."""
        disarmed = max((link.at for link in self._links.values() if not link.armed), default=None)
        armed = max((link.at for link in self._links.values() if link.armed), default=None)
        if disarmed is None or armed is None or disarmed <= armed:
            return False
        return self.landed is None or armed - self.landed > self._timeout_s
