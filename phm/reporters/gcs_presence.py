"""Detects new ground stations, which have received nothing yet. Not thread-safe."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

from phm.transport.dialect import mavlink

MAX_STATIONS = 16


class GcsPresence:
    """own: this agent's system id, which a program on board may use as a ground station. timeout_s: a station that was silent for
    longer has missed messages."""

    def __init__(self, own: int, timeout_s: float) -> None:
        self._own, self._timeout_s = own, timeout_s
        self._received: OrderedDict[tuple[int, int], float] = OrderedDict()

    def appears(self, message: Any, now: float) -> bool:
        """Whether this HEARTBEAT is from a ground station that is new or back."""
        if message.type != mavlink.MAV_TYPE_GCS or message.get_srcSystem() == self._own:
            return False
        sender = (message.get_srcSystem(), message.get_srcComponent())
        received = self._received.pop(sender, None)
        if message.system_status == mavlink.MAV_STATE_POWEROFF:
            return False  # it ends; when it is back, it is new
        self._received[sender] = now
        while len(self._received) > MAX_STATIONS:
            self._received.popitem(last=False)
        return received is None or now - received > self._timeout_s
