"""A simulated autopilot without sockets. Used by `phm.simulation.autopilot` and by the swarm's link emulator.

It sends what an ArduPilot copter sends by default, as recorded from a real one (tests/recorded/ardupilot): HEARTBEAT, texts,
TIMESYNC every 10 s and few parameters. Streams (SYSTEM_TIME, ATTITUDE, GLOBAL_POSITION_INT) are off on each port until they are
requested there. It executes the commands to arm, to reboot, and for messages. Armed, it flies a circle.
"""

from __future__ import annotations

import math
import time
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

from phm.simulation.mavlink_port import mavlink

AUTOPILOT = 1
HEARTBEAT_S = 1.0
TIMESYNC_S = 10.0
PARAMETERS_S = 30.0
BOOT_S = 6.0
"""Silence of a reboot. A real one: 6.2 s, then one more second until the first HEARTBEAT."""
FIRST_HEARTBEAT_S, READY_S = 1.0, 2.4
"""From the end of that silence: the first HEARTBEAT, which says BOOT, and the end of its start."""
DISARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | 16
COPTER_LOITER = 5
HOME_E7 = (473977418, 85455939)
"""Latitude and longitude of agent 0; the others are in a row to the east."""
APART_E7, CIRCLE_E7, TURN_S, HEIGHT_MM = 1300, 1800, 60.0, 30_000


@dataclass(frozen=True, slots=True)
class Answer:
    """everyone: sent on all ports, else only on the one that asked."""

    frame: bytes
    everyone: bool = False


@dataclass(slots=True)
class _Stream:
    period_s: float
    due: float = field(default=float("-inf"))


class AutopilotModel:
    """Times are of the caller's monotonic clock. `armed` and `hung` may be set from outside; while it is hung it sends
    and executes nothing. reboot_s: silence of a commanded reboot. stream_hz: rate of all streams on all ports after a start (ArduPilot: `MAVn_*`).
    """

    def __init__(
        self, system_id: int, now: float, *, armed: bool = False, reboot_s: float = BOOT_S, stream_hz: float = 0.0
    ) -> None:
        self.system_id, self.armed, self.hung = system_id, armed, False
        self._reboot_s = reboot_s
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT)
        self._stream_hz = stream_hz
        self._boot_until: float | None = None
        self._makers = {
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._position,
        }
        self._start(now, first_heartbeat_s=0.0)

    def _start(self, now: float, *, first_heartbeat_s: float) -> None:
        self._started = now
        self._streams: dict[Hashable, dict[int, _Stream]] = {}
        self._texts = [(now + 0.2, "Calibrating barometer"), (now + READY_S, "ArduPilot Ready")]
        self._due = {
            self._heartbeat: (now + first_heartbeat_s, HEARTBEAT_S),
            self._timesync: (now + TIMESYNC_S, TIMESYNC_S),
            self._parameter: (now + PARAMETERS_S, PARAMETERS_S),
        }

    def reboot(self, now: float, boot_s: float | None = None) -> None:
        """Be silent for `boot_s` (default: `reboot_s`), then disarmed, with a new time since boot and no requested streams."""
        self._boot_until = now + (self._reboot_s if boot_s is None else boot_s)

    def booted(self, now: float) -> bool:
        """Whether a reboot has just ended: true once."""
        if self._boot_until is None or now < self._boot_until:
            return False
        self._boot_until, self.armed = None, False
        self._mav.seq = 0
        self._start(now, first_heartbeat_s=FIRST_HEARTBEAT_S)
        return True

    @property
    def rebooting(self) -> bool:
        return self._boot_until is not None

    @property
    def unresponsive(self) -> bool:
        return self.hung or self.rebooting

    def due(self, now: float) -> list[bytes]:
        """The frames that are due at `now` on all ports."""
        if self.unresponsive:
            return []
        found = []
        while self._texts and now >= self._texts[0][0]:
            found.append(self._text(self._texts.pop(0)[1]))
        for make, (due, period_s) in list(self._due.items()):
            if now >= due:
                self._due[make] = (now + period_s, period_s)
                found.append(make(now))
        return found

    def due_on(self, now: float, port: Hashable = None) -> list[bytes]:
        """The frames of the port's streams that are due at `now`."""
        if self.unresponsive:
            return []
        found = []
        for message_id, stream in self._streams_of(port).items():
            if now >= stream.due:
                stream.due = now + stream.period_s
                found.append(self._makers[message_id](now))
        return found

    def next_s(self) -> float:
        """The time at which the next frame may be due."""
        if self._boot_until is not None:
            return self._boot_until
        streams = (stream.due for port in self._streams.values() for stream in port.values())
        return min([*(due for due, _ in self._due.values()), *(at for at, _ in self._texts), *streams])

    def handle(self, now: float, message: Any, port: Hashable = None) -> list[Answer]:
        """The answer to a message for the autopilot that arrived on `port`: an acknowledgement, and its new state."""
        if self.unresponsive:
            return []
        if message.get_type() == "REQUEST_DATA_STREAM":
            hertz = message.req_message_rate if message.start_stop else 0
            for message_id in self._makers:
                self._request(message_id, 1.0 / hertz if hertz else 0.0, port)
            return []
        if message.get_type() != "COMMAND_LONG":
            return []
        result, more = self._execute(now, message, port)
        ack = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        return [Answer(self._pack(ack)), *more]

    def _execute(self, now: float, message: Any, port: Hashable) -> tuple[int, list[Answer]]:
        """The result of a command, and what else is sent."""
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 >= 0.5
            text = self._text("Arming motors" if self.armed else "Disarming motors")
            return mavlink.MAV_RESULT_ACCEPTED, [Answer(text, True), Answer(self._heartbeat(now), True)]
        if message.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and message.param1 == 1:
            self.reboot(now)
            return mavlink.MAV_RESULT_ACCEPTED, []
        if message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL and int(message.param1) in self._makers:
            self._request(int(message.param1), message.param2 / 1e6, port)
            return mavlink.MAV_RESULT_ACCEPTED, []
        if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE and int(message.param1) in self._makers:
            return mavlink.MAV_RESULT_ACCEPTED, [Answer(self._makers[int(message.param1)](now))]
        return mavlink.MAV_RESULT_UNSUPPORTED, []

    def _request(self, message_id: int, period_s: float, port: Hashable) -> None:
        """Set the period of one message on one port; 0 and less: off."""
        streams = self._streams_of(port)
        streams.pop(message_id, None)
        if period_s > 0:
            streams[message_id] = _Stream(period_s)

    def _streams_of(self, port: Hashable) -> dict[int, _Stream]:
        if port not in self._streams:
            of_all = {message_id: _Stream(1.0 / self._stream_hz) for message_id in self._makers if self._stream_hz}
            self._streams[port] = of_all
        return self._streams[port]

    def _heartbeat(self, now: float) -> bytes:
        mode = DISARMED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        status = mavlink.MAV_STATE_STANDBY if now - self._started >= READY_S else mavlink.MAV_STATE_BOOT
        if self.armed:
            status = mavlink.MAV_STATE_ACTIVE
        return self._pack(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, COPTER_LOITER, status, 3
            )
        )

    def _text(self, words: str) -> bytes:
        return self._pack(mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, words.encode()))

    def _timesync(self, now: float) -> bytes:
        return self._pack(mavlink.MAVLink_timesync_message(0, int((now - self._started) * 1e9)))

    def _parameter(self, now: float) -> bytes:
        runtime_s = float(int(now - self._started))
        kind = mavlink.MAV_PARAM_TYPE_INT32
        return self._pack(mavlink.MAVLink_param_value_message(b"STAT_RUNTIME", runtime_s, kind, 1349, 65535))

    def _system_time(self, now: float) -> bytes:
        return self._pack(mavlink.MAVLink_system_time_message(int(time.time() * 1e6), self._boot_ms(now)))

    def _position(self, now: float) -> bytes:
        turn = 2 * math.pi * (now - self._started) / TURN_S
        north, east = (CIRCLE_E7 * math.sin(turn), CIRCLE_E7 * math.cos(turn)) if self.armed else (0, 0)
        height = HEIGHT_MM if self.armed else 0
        place = (HOME_E7[0] + int(north), HOME_E7[1] + self.system_id * APART_E7 + int(east))
        message = mavlink.MAVLink_global_position_int_message(
            self._boot_ms(now), *place, 408_000 + height, height, 0, 0, 0, 65535
        )
        return self._pack(message)

    def _attitude(self, now: float) -> bytes:
        swing = 0.05 * math.sin(now - self._started)
        return self._pack(mavlink.MAVLink_attitude_message(self._boot_ms(now), swing, swing, 0.0, 0.0, 0.0, 0.0))

    def _boot_ms(self, now: float) -> int:
        return int((now - self._started) * 1000) & 0xFFFFFFFF

    def _pack(self, message: Any) -> bytes:
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
