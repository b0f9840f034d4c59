"""Messages of an autopilot about its time since boot and its reboots, and requests for them. Pure."""

from __future__ import annotations

from typing import Any

from phm.facts.links import AutopilotFact
from phm.transport.dialect import mavlink

TIMES = (
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_TIMESYNC,
)
"""Messages that contain its time since boot."""
REBOOTS = (mavlink.MAVLINK_MSG_ID_STATUSTEXT, mavlink.MAVLINK_MSG_ID_COMMAND_ACK)
"""Messages that may announce or report a reboot."""
LONGEST_MS = 2**32
"""A TIMESYNC above the range of `time_boot_ms` is of a clock that does not start at boot."""
READY = "ArduPilot Ready"
INTERVAL_S = 1.0
"""Requested period of SYSTEM_TIME: 24 bytes each."""
MISSING_S = 3.0
"""Without a time since boot for this long, it is not being sent: also after a reboot, which ends all requested streams."""
AGAIN_S = 10.0


def boot_ms(message: Any) -> int | None:
    """How long the sender has been running, in milliseconds; None if the message does not contain it.

    A TIMESYNC request has its sender's clock in `ts1`, a response in `tc1`, in nanoseconds; with ArduPilot and PX4 that
    is the time since boot.
    """
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_TIMESYNC:
        return int(message.time_boot_ms)
    since_boot_ms = (message.tc1 or message.ts1) // 1_000_000
    return int(since_boot_ms) if 0 < since_boot_ms < LONGEST_MS else None


def has_started(message: Any) -> bool:
    """Whether it is the text that ArduPilot sends at the end of its start."""
    return bool(message.get_msgId() == mavlink.MAVLINK_MSG_ID_STATUSTEXT and message.text == READY)


def will_reboot(message: Any) -> bool:
    """Whether it acknowledges MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN. Of what, the autopilot or the companion, it does not say."""
    if message.get_msgId() != mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
        return False
    accepted = message.result == mavlink.MAV_RESULT_ACCEPTED
    return bool(accepted and message.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN)


class BootTimeRequests:
    """Decides when to request SYSTEM_TIME from one autopilot. Not thread-safe."""

    def __init__(self, system_id: int) -> None:
        self._system_id = system_id
        self._sent = float("-inf")

    def due(self, now: float, fact: AutopilotFact | None) -> Any | None:
        """The command to send now by the link of the newest heartbeat; None: none is due."""
        if fact is None or fact.age_s > MISSING_S or now - self._sent < AGAIN_S:
            return None
        if fact.boot_age_s is not None and fact.boot_age_s < MISSING_S:
            return None
        self._sent = now
        return mavlink.MAVLink_command_long_message(
            self._system_id,
            mavlink.MAV_COMP_ID_AUTOPILOT1,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
            INTERVAL_S * 1e6,
            0,
            0,
            0,
            0,
            0,
        )
