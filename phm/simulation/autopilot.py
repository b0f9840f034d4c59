"""A simulated autopilot between companion computer and ground, as seen by PHM.

``python -m phm.simulation.autopilot --id 1 --companion udpin:0.0.0.0:14550 --ground tcpin:0.0.0.0:5760 [--armed]``

`phm.simulation.autopilot_model` defines what it sends and which commands it executes. It forwards frames between its
links unchanged, by ArduPilot's rules, as measured on a real one: a link gets forwarded frames only after it has sent a
packet; frames that claim to be from the autopilot are dropped; messages to the autopilot and a radio's RADIO_STATUS are
not forwarded. A reboot closes its TCP connections for six seconds. After a hang it processes everything that has arrived meanwhile
in one burst.
"""

from __future__ import annotations

import argparse
import select
import signal
import sys
import threading
import time
from collections.abc import Hashable
from typing import Any

from phm.simulation.autopilot_model import AUTOPILOT, BOOT_S, AutopilotModel
from phm.simulation.mavlink_port import Port


class SimulatedAutopilot:
    """Runs in one thread: `run` until `stop`. `armed` and `hung` may be set from outside; while it is hung its ports
    stay open, and nothing is read, sent or forwarded. reboot_s: silence of a commanded reboot. stream_hz: as in
    `AutopilotModel`. Raises OSError when a port is in use.
    """

    def __init__(
        self,
        system_id: int,
        companion: str,
        ground: str,
        *,
        armed: bool = False,
        reboot_s: float = BOOT_S,
        stream_hz: float = 0.0,
    ) -> None:
        self.system_id = system_id
        self.companion, self.ground = Port(companion), Port(ground)
        self._pilot = AutopilotModel(system_id, time.monotonic(), armed=armed, reboot_s=reboot_s, stream_hz=stream_hz)
        self._interrupted = False
        self._routes: dict[tuple[int, int], Port] = {}
        self._stopping = threading.Event()

    @property
    def armed(self) -> bool:
        return self._pilot.armed

    @armed.setter
    def armed(self, armed: bool) -> None:
        self._pilot.armed = armed

    @property
    def hung(self) -> bool:
        return self._pilot.hung

    @hung.setter
    def hung(self, hung: bool) -> None:
        self._pilot.hung = hung

    def reboot(self, boot_s: float | None = None) -> None:
        """Close TCP connections, be silent for `boot_s` (default: `reboot_s`), and forget routes, streams, arming and the time
        since boot."""
        self._pilot.reboot(time.monotonic(), boot_s)

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
        self._follow_reboot()
        if self._pilot.hung:
            self._stopping.wait(0.05)
            return
        ports = {sock: port for port in (self.companion, self.ground) for sock in port.sockets()}
        readable, _, _ = select.select(list(ports), [], [], 0.05)
        for sock in readable:
            port = ports[sock]
            for peer, message in port.receive(sock):
                if not self._pilot.rebooting:  # what was read before it hangs is still processed
                    self._take(port, peer, message)
        self._send(self._pilot.due(time.monotonic()))
        for port in (self.companion, self.ground):
            for frame in self._pilot.due_on(time.monotonic(), port):
                port.send(frame)

    def _follow_reboot(self) -> None:
        if self._pilot.booted(time.monotonic()):
            self._routes.clear()
            self.companion.resume()
            self.ground.resume()
            self._interrupted = False
        elif self._pilot.rebooting and not self._interrupted:
            self._interrupted = True
            self.companion.interrupt()
            self.ground.interrupt()

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
        for answer in self._pilot.handle(time.monotonic(), message, port):
            if answer.everyone:
                self._send([answer.frame])
            else:
                port.send(answer.frame)

    def _send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self.companion.send(frame)
            self.ground.send(frame)


def main(arguments: list[str] | None = None) -> int:
    words = argparse.ArgumentParser(prog="python -m phm.simulation.autopilot", description=__doc__.partition("\n")[0])
    words.add_argument("--id", type=int, default=1, help="MAVLink system id (1)")
    words.add_argument("--companion", default="udpin:0.0.0.0:14550", metavar="URL", help="where PHM connects")
    words.add_argument("--ground", default="tcpin:0.0.0.0:5760", metavar="URL", help="where ground stations connect")
    words.add_argument("--armed", action="store_true", help="begin armed")
    words.add_argument(
        "--reboot", type=float, default=BOOT_S, metavar="SECONDS", help="silence of a reboot (%(default)g)"
    )
    words.add_argument(
        "--streams", type=float, default=0.0, metavar="HZ", help="send position, attitude and time unrequested (off)"
    )
    chosen = words.parse_args(arguments)
    try:
        pilot = SimulatedAutopilot(
            chosen.id,
            chosen.companion,
            chosen.ground,
            armed=chosen.armed,
            reboot_s=chosen.reboot,
            stream_hz=chosen.streams,
        )
    except OSError as error:
        print(f"phm.simulation.autopilot: {error}", file=sys.stderr)
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: pilot.stop())
    print(f"autopilot {chosen.id}: companion {chosen.companion}, ground {chosen.ground}", flush=True)
    pilot.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
