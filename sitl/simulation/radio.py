"""A simulated pair of telemetry radios between companion computer (or autopilot) and ground.

``python -m sitl.simulation.radio --near tcpin:0.0.0.0:5790 --far tcpin:0.0.0.0:5760``

Like the firmware of SiK radios: a radio answers each HEARTBEAT from its own side with a RADIO_STATUS to that side, as
system 51 component 68, whether or not the other radio is received; the values of the other radio are zero once nothing
was received from it for a while. All other messages are forwarded unchanged.
"""

from __future__ import annotations

import argparse
import random
import select
import signal
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any

from phm.simulation.mavlink_port import Port, mavlink

SYSTEM, COMPONENT = ord("3"), ord("D")
FILLS = 10
"""Percent of the transmit buffer that each frame takes while the other radio does not listen."""


@dataclass
class AirSettings:
    """The state of the radio link, set from outside. Signal and noise in the radios' units, loss 0 to 1."""

    rssi: int = 180
    noise: int = 40
    loss: float = 0.0
    cut: bool = False
    """The radios do not receive each other."""


FORGETS_S = 3.4
"""As in `sitl.simulation.vehicle`."""


class _End:
    """One of the two radios, with the port of its own side."""

    def __init__(self, port: Port) -> None:
        self.port = port
        self.off = False
        self.free, self.rxerrors = 100, 0
        self.partner_at = time.monotonic()
        self._mav = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)

    def report(self, air: AirSettings) -> None:
        """Send RADIO_STATUS to its own side."""
        known = time.monotonic() - self.partner_at <= FORGETS_S
        far_rssi, far_noise = (air.rssi, air.noise) if known else (0, 0)
        message = mavlink.MAVLink_radio_status_message(
            air.rssi, far_rssi, self.free, air.noise, far_noise, min(self.rxerrors, 0xFFFF), 0
        )
        self.port.send(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256


class Radio:
    """Runs in one thread: `run` until `stop`. near, far: where the two radios are connected, as in
    `phm.simulation.mavlink_port.Port`. `air` and `near.off`, `far.off` (no power) may be set from outside. Raises OSError when
    a port is in use.
    """

    def __init__(self, near: str, far: str, seed: int = 0) -> None:
        self.air = AirSettings()
        self.near, self.far = _End(Port(near)), _End(Port(far))
        self._random = random.Random(seed)
        self._stopping = threading.Event()

    def stop(self) -> None:
        self._stopping.set()

    def run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
        finally:
            self.near.port.close()
            self.far.port.close()

    def _turn(self) -> None:
        ends = {sock: end for end in (self.near, self.far) for sock in end.port.sockets()}
        readable, _, _ = select.select(list(ends), [], [], 0.05)
        if not (self.air.cut or self.near.off or self.far.off):
            self.near.partner_at = self.far.partner_at = time.monotonic()
        for sock in readable:
            end = ends[sock]
            for _, message in end.port.receive(sock):
                self._take(end, self.far if end is self.near else self.near, message)

    def _take(self, end: _End, other: _End, message: Any) -> None:
        if end.off:
            return
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            end.report(self.air)
        if self.air.cut or other.off:
            end.free = max(0, end.free - FILLS)
        elif self._random.random() < self.air.loss:
            other.rxerrors += 1
        else:
            end.free = 100
            other.port.send(bytes(message.get_msgbuf()))


def main(arguments: list[str] | None = None) -> int:
    words = argparse.ArgumentParser(prog="python -m sitl.simulation.radio", description=__doc__.partition("\n")[0])
    words.add_argument(
        "--near", default="tcpin:0.0.0.0:5790", metavar="URL", help="where PHM or the autopilot connects"
    )
    words.add_argument("--far", default="tcpin:0.0.0.0:5760", metavar="URL", help="where ground stations connect")
    words.add_argument("--loss", type=float, default=0.0, help="share of the frames that get lost, 0 to 1 (0)")
    chosen = words.parse_args(arguments)
    try:
        radio = Radio(chosen.near, chosen.far)
    except OSError as error:
        print(f"sitl.simulation.radio: {error}", file=sys.stderr)
        return 1
    radio.air.loss = chosen.loss
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: radio.stop())
    print(f"radio: near {chosen.near}, far {chosen.far}", flush=True)
    radio.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
