"""A MAVLink frame on its way, with what routers look at."""

from __future__ import annotations

from typing import Any, NamedTuple

from sitl.simulation.link import mavlink

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
RADIO_STATUS = mavlink.MAVLINK_MSG_ID_RADIO_STATUS


class Frame(NamedTuple):
    """raw: the bytes as they came. target_system, target_component: 0 where it is for all."""

    raw: bytes
    kind: int
    system: int
    component: int
    target_system: int = 0
    target_component: int = 0
    message: Any = None

    @classmethod
    def of(cls, message: Any) -> Frame:
        """What pymavlink has decoded."""
        return cls(
            bytes(message.get_msgbuf()),
            message.get_msgId(),
            message.get_srcSystem(),
            message.get_srcComponent(),
            getattr(message, "target_system", 0),
            getattr(message, "target_component", 0),
            message,
        )
