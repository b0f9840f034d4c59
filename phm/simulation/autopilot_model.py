"""A simulated autopilot without sockets. Used by `phm.simulation.autopilot` and by the swarm's link emulator.

It sends the messages of an ArduPilot copter (HEARTBEAT, SYSTEM_TIME, ATTITUDE, GLOBAL_POSITION_INT) and executes
MAV_CMD_COMPONENT_ARM_DISARM and MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN. Armed, it flies a circle.
"""

from __future__ import annotations

import math
import time
from typing import Any

from phm.simulation.mavlink_port import mavlink

AUTOPILOT = 1
HEARTBEAT_S = 1.0
ATTITUDE_S = 0.25
BOOT_S = 1.0
DISARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | 16
COPTER_LOITER = 5
HOME_E7 = (473977418, 85455939)
"""Latitude and longitude of agent 0; the others are in a row to the east."""
APART_E7, CIRCLE_E7, TURN_S, HEIGHT_MM = 1300, 1800, 60.0, 30_000


class AutopilotModel:
    """Times are of the caller's monotonic clock. `armed` and `hung` may be set from outside; while it is hung it sends
    and executes nothing.
    """

    def __init__(self, system_id: int, now: float, *, armed: bool = False) -> None:
        self.system_id, self.armed, self.hung = system_id, armed, False
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT)
        self._started = now
        self._boot_until: float | None = None
        self._due = {self._heartbeat: now, self._attitude: now}

    def reboot(self, now: float, boot_s: float = BOOT_S) -> None:
        """Be silent for `boot_s`, then disarmed, with a new time since boot."""
        self._boot_until = now + boot_s

    def booted(self, now: float) -> bool:
        """Whether a reboot has just ended: true once."""
        if self._boot_until is None or now < self._boot_until:
            return False
        self._boot_until, self._started, self.armed = None, now, False
        self._mav.seq = 0
        return True

    @property
    def dumb(self) -> bool:
        return self.hung or self._boot_until is not None

    def due(self, now: float) -> list[bytes]:
        """The frames that are due at `now`."""
        if self.dumb:
            return []
        found = []
        for make, period_s in ((self._heartbeat, HEARTBEAT_S), (self._attitude, ATTITUDE_S)):
            if now >= self._due[make]:
                self._due[make] = now + period_s
                found += make(now)
        return found

    def next_s(self) -> float:
        """The time at which the next frame may be due."""
        return self._boot_until if self._boot_until is not None else min(self._due.values())

    def obey(self, now: float, message: Any) -> list[bytes]:
        """The answer to a message for the autopilot: an acknowledgement, and its new state."""
        if self.dumb or message.get_type() != "COMMAND_LONG":
            return []
        result = mavlink.MAV_RESULT_UNSUPPORTED
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 >= 0.5
            result = mavlink.MAV_RESULT_ACCEPTED
        elif message.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and message.param1 == 1:
            self.reboot(now)
            result = mavlink.MAV_RESULT_ACCEPTED
        return [
            self._pack(
                mavlink.MAVLink_command_ack_message(
                    message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
                )
            ),
            *self._heartbeat(now),
        ]

    def _heartbeat(self, now: float) -> list[bytes]:
        mode = DISARMED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        status = mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, COPTER_LOITER, status, 3
        )
        clock = mavlink.MAVLink_system_time_message(int(time.time() * 1e6), self._boot_ms(now))
        return [self._pack(beat), self._pack(clock), self._pack(self._position(now))]

    def _position(self, now: float) -> Any:
        turn = 2 * math.pi * (now - self._started) / TURN_S
        north, east = (CIRCLE_E7 * math.sin(turn), CIRCLE_E7 * math.cos(turn)) if self.armed else (0, 0)
        height = HEIGHT_MM if self.armed else 0
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(now),
            HOME_E7[0] + int(north),
            HOME_E7[1] + self.system_id * APART_E7 + int(east),
            408_000 + height,
            height,
            0,
            0,
            0,
            65535,
        )

    def _attitude(self, now: float) -> list[bytes]:
        swing = 0.05 * math.sin(now - self._started)
        return [self._pack(mavlink.MAVLink_attitude_message(self._boot_ms(now), swing, swing, 0.0, 0.0, 0.0, 0.0))]

    def _boot_ms(self, now: float) -> int:
        return int((now - self._started) * 1000) & 0xFFFFFFFF

    def _pack(self, message: Any) -> bytes:
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
