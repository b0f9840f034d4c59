"""A simulated autopilot between companion computer and ground, as far as PHM can tell the difference.

``python -m sitl.autopilot --id 1 --companion udpin:0.0.0.0:14550 --ground tcpin:0.0.0.0:5760 [--armed]``

It sends what an ArduPilot copter sends (HEARTBEAT, SYSTEM_TIME, ATTITUDE), obeys
MAV_CMD_COMPONENT_ARM_DISARM and MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, and passes frames between its links unchanged by ArduPilot's rules, measured
on a real one: a link gets passed-on frames only after it has itself sent a packet; frames that claim to be
from the autopilot itself vanish; what is addressed to the autopilot stays with it, and so does a radio's RADIO_STATUS.
"""

from __future__ import annotations

import argparse
import math
import select
import signal
import sys
import threading
import time
from collections.abc import Hashable
from typing import Any

from sitl.link import Port, mavlink

AUTOPILOT = 1
HEARTBEAT_S = 1.0
ATTITUDE_S = 0.25
BOOT_S = 1.0
DISARMED = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | 16
COPTER_LOITER = 5


class Autopilot:
    """Runs in one thread: `run` until `stop`. `armed` may be set from outside, and `hung`: its ports stay open, and nothing
    comes or is passed on. Raises OSError when a port is taken."""

    def __init__(self, system_id: int, companion: str, ground: str, *, armed: bool = False) -> None:
        self.system_id, self.armed, self.hung = system_id, armed, False
        self.companion, self.ground = Port(companion), Port(ground)
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=AUTOPILOT)
        self._started = time.monotonic()
        self._due = {self._heartbeat: 0.0, self._attitude: 0.0}
        self._routes: dict[tuple[int, int], Port] = {}
        self._stopping = threading.Event()
        self._boot_until: float | None = None

    def reboot(self, boot_s: float = BOOT_S) -> None:
        """Its ports stay; it is silent for so long, has forgotten routes and arming, and its time since boot begins anew."""
        self._boot_until = time.monotonic() + boot_s

    def stop(self) -> None:
        self._stopping.set()

    def run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
        finally:
            self.companion.close()
            self.ground.close()

    def _turn(self) -> None:
        if self._boot_until is not None and time.monotonic() >= self._boot_until:
            self._boot_until, self._started = None, time.monotonic()
            self.armed = False
            self._routes.clear()
            self._mav.seq = 0
        ports = {sock: port for port in (self.companion, self.ground) for sock in port.sockets()}
        readable, _, _ = select.select(list(ports), [], [], 0.05)
        for sock in readable:
            port = ports[sock]
            for peer, message in port.receive(sock):
                if not self._dumb:
                    self._take(port, peer, message)
        now = time.monotonic()
        if self._dumb:
            return
        for send, period_s in ((self._heartbeat, HEARTBEAT_S), (self._attitude, ATTITUDE_S)):
            if now >= self._due[send]:
                self._due[send] = now + period_s
                send()

    @property
    def _dumb(self) -> bool:
        return self.hung or self._boot_until is not None

    def _take(self, port: Port, peer: Hashable, message: Any) -> None:
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source == (self.system_id, AUTOPILOT) or message.get_type() == "RADIO_STATUS":
            return
        if len(self._routes) < 20:  # as many as ArduPilot keeps
            self._routes[source] = port
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if system == self.system_id and component in (0, AUTOPILOT):
            self._obey(port, message)
            if component == AUTOPILOT:
                return
        frame = bytes(message.get_msgbuf())
        route = self._routes.get((system, component)) if system and component else None
        for other in (self.companion, self.ground):
            if route is None or other is route:
                other.send(frame, spoken_only=True, but=peer if other is port else None)

    def _obey(self, port: Port, message: Any) -> None:
        if message.get_type() != "COMMAND_LONG":
            return
        result = mavlink.MAV_RESULT_UNSUPPORTED
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 >= 0.5
            result = mavlink.MAV_RESULT_ACCEPTED
        elif message.command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN and message.param1 == 1:
            self.reboot()
            result = mavlink.MAV_RESULT_ACCEPTED
        acknowledgement = mavlink.MAVLink_command_ack_message(
            message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
        )
        port.send(self._pack(acknowledgement))
        self._heartbeat()

    def _heartbeat(self) -> None:
        mode = DISARMED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        status = mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY
        self._send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, COPTER_LOITER, status, 3
            )
        )
        self._send(mavlink.MAVLink_system_time_message(int(time.time() * 1e6), self._boot_ms()))

    def _attitude(self) -> None:
        swing = 0.05 * math.sin(time.monotonic() - self._started)
        self._send(mavlink.MAVLink_attitude_message(self._boot_ms(), swing, swing, 0.0, 0.0, 0.0, 0.0))

    def _boot_ms(self) -> int:
        return int((time.monotonic() - self._started) * 1000) & 0xFFFFFFFF

    def _send(self, message: Any) -> None:
        frame = self._pack(message)
        self.companion.send(frame)
        self.ground.send(frame)

    def _pack(self, message: Any) -> bytes:
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame


def main(arguments: list[str] | None = None) -> int:
    words = argparse.ArgumentParser(prog="python -m sitl.autopilot", description=__doc__.partition("\n")[0])
    words.add_argument("--id", type=int, default=1, help="MAVLink system id (1)")
    words.add_argument("--companion", default="udpin:0.0.0.0:14550", metavar="URL", help="where PHM connects")
    words.add_argument("--ground", default="tcpin:0.0.0.0:5760", metavar="URL", help="where ground stations connect")
    words.add_argument("--armed", action="store_true", help="begin armed")
    chosen = words.parse_args(arguments)
    try:
        pilot = Autopilot(chosen.id, chosen.companion, chosen.ground, armed=chosen.armed)
    except OSError as error:
        print(f"sitl.autopilot: {error}", file=sys.stderr)
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: pilot.stop())
    print(f"autopilot {chosen.id}: companion {chosen.companion}, ground {chosen.ground}", flush=True)
    pilot.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
