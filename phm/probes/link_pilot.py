"""The vehicle's autopilot by its heartbeats, and its reboots by the time since boot that it tells. Pure.

As ArduPilot's routing asks of ground stations, a reboot is seen by `time_boot_ms` going back: in SYSTEM_TIME, or in whatever
else carries it. It must not be missed, for an autopilot that reboots within seconds leaves no gap in its heartbeats.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from phm.link_facts import AutopilotFact
from phm.transport.dialect import mavlink

BACK_S = 3.0
"""Messages overtake each other, and some carry the time of a measurement and not of sending."""
WRAP_S, WRAPS_AT_S = 60.0, 2**32 / 1000.0
TWINS, TWINS_S = 4, 6.0
"""An autopilot that reboots again and again has run for BACK_S each time: faster than so, two of them speak."""
KEPT = 16


class Pilot:
    """Not thread-safe."""

    def __init__(self) -> None:
        self._beat: tuple[float, Any, str] | None = None
        self._armed: deque[tuple[float, bool]] = deque(maxlen=KEPT)
        """Changes of the armed state, with when they were seen."""
        self._boot: tuple[float, float] | None = None
        """When the newest time since boot was heard, and that time in seconds."""
        self._seen: deque[float] = deque(maxlen=TWINS)
        self.reboots = 0
        self._rebooted_armed = False

    def heartbeat(self, now: float, message: Any, link: str) -> None:
        self._beat = (now, message, link)
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if not self._armed or self._armed[-1][1] != armed:
            self._armed.append((now, armed))

    def booted(self, now: float, time_boot_ms: int) -> None:
        """It says that it has run for so long."""
        new_s = time_boot_ms / 1000.0
        old_s = self._boot[1] if self._boot is not None else 0.0
        wrapped = old_s > WRAPS_AT_S - WRAP_S and new_s < WRAP_S
        if new_s < old_s - BACK_S and not wrapped:
            self._seen.append(now)
            self.reboots += 1
            self._rebooted_armed = self._armed_at(now - new_s)
        self._boot = (now, new_s)

    def twins(self, now: float) -> bool:
        """Whether two autopilots speak with one identity."""
        return len(self._seen) == TWINS and self._seen[-1] - self._seen[0] < TWINS_S and now - self._seen[-1] < TWINS_S

    def fact(self, now: float) -> AutopilotFact | None:
        """None: never heard."""
        if self._beat is None:
            return None
        heard, message, link = self._beat
        rebooted = bool(self._seen) and not self.twins(now)
        return AutopilotFact(
            now - heard, self._armed[-1][1], message.custom_mode, message.system_status, link,
            self._boot[1] + now - self._boot[0] if self._boot is not None else None,
            self.reboots, now - self._seen[-1] if rebooted else None, rebooted and self._rebooted_armed,
        )  # fmt: skip

    def _armed_at(self, moment: float) -> bool:
        """As last heard before `moment`: after a reboot the first heartbeat, disarmed, may come before the new time."""
        return next((armed for at, armed in reversed(self._armed) if at <= moment), False)
