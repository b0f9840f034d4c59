"""A MAVLink frame in transit, with the fields that routers use."""

from __future__ import annotations

from typing import Any, NamedTuple

from phm.simulation.mavlink_port import mavlink

HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
RADIO_STATUS = mavlink.MAVLINK_MSG_ID_RADIO_STATUS


class Frame(NamedTuple):
    """raw: the unchanged bytes. target_system, target_component: 0 for a broadcast."""

    raw: bytes
    kind: int
    system: int
    component: int
    target_system: int = 0
    target_component: int = 0
    message: Any = None

    @classmethod
    def of(cls, message: Any) -> Frame:
        """The frame of a message that pymavlink has decoded."""
        return cls(
            bytes(message.get_msgbuf()),
            message.get_msgId(),
            message.get_srcSystem(),
            message.get_srcComponent(),
            getattr(message, "target_system", 0),
            getattr(message, "target_component", 0),
            message,
        )
