"""The sockets of an ArduPilot SITL that plays a session: it behaves as measured on a real one (docs/development/sitl.md).

It starts when a client connects to serial port 0, opens serial port 1 only then, sends the session's frames to both unchanged,
and keeps received frames. A session is a telemetry log (`.tlog`), as MAVProxy and ground stations record them: for each
frame eight bytes of time, big-endian microseconds since 1970, and then the frame.
"""

from __future__ import annotations

import struct
import threading
from pathlib import Path
from typing import Any

from phm.simulation.mavlink_port import Port, mavlink, parser

STEP_S = 0.02


def read(file: Path) -> list[tuple[int, bytes]]:
    """Microseconds and frame of each entry. ValueError at the first byte that is not of this format."""
    data, at, found = file.read_bytes(), 0, []
    while at < len(data):
        (stamp,) = struct.unpack_from(">Q", data, at)
        start = at + 8
        if data[start] != 0xFD:
            raise ValueError(
                f"{file}: byte {start} is 0x{data[start]:02x}, expected the beginning of a MAVLink 2 frame"
            )
        signed = 13 if data[start + 2] & 1 else 0
        at = start + 12 + data[start + 1] + signed
        found.append((stamp, data[start:at]))
    return found


class ArduPilot:
    """`serial_0` is open from the start, `serial_1` after booting; `received` has the received frames by serial port."""

    def __init__(self, session: Path) -> None:
        self._frames = [frame for _, frame in read(session)]
        self.serial_0 = Port("tcpin:127.0.0.1:0")
        self.serial_1: Port | None = None
        self.received: dict[int, list[Any]] = {0: [], 1: []}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ardupilot", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join(60)
        for port in self._ports():
            port.close()

    def _ports(self) -> list[Port]:
        return [self.serial_0] if self.serial_1 is None else [self.serial_0, self.serial_1]

    def _run(self) -> None:
        number = 0
        while not self._stopping.wait(STEP_S):
            for place, port in enumerate(self._ports()):
                for sock in port.sockets():
                    self.received[place] += [message for _, message in port.receive(sock)]
            if self.serial_1 is None and self.serial_0.peers:
                self.serial_1 = Port("tcpin:127.0.0.1:0")
            if self.serial_1 is not None:
                for port in self._ports():
                    port.send(self._frames[number % len(self._frames)])
                number += 1


def decoded(frame: bytes) -> Any:
    """The frame, decoded by pymavlink."""
    return (parser().parse_buffer(frame) or [None])[0]


def record(file: Path, system: int) -> None:
    """A session as a copter on the ground sends it after a ground station has connected, in the form of a recording.

    Not a recording: values and types were measured on ArduCopter 4.7-dev (HEARTBEAT with base_mode 81, 217 when
    armed; banner and frame as STATUSTEXT; message types of ArduPilot's own dialect).
    """
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    boot_ms, entries = 4000, []

    def put(message: Any) -> None:
        raw = message.pack(mav)
        mav.seq = (mav.seq + 1) % 256
        entries.append(struct.pack(">Q", 1_790_000_000_000_000 + boot_ms * 1000) + raw)

    put(mavlink.MAVLink_statustext_message(6, b"ArduCopter V4.7.0-dev (0000000)"))
    put(mavlink.MAVLink_statustext_message(6, b"Frame: QUAD/PLUS"))
    for second in range(20):
        boot_ms = 4000 + second * 1000
        armed = 128 if second >= 10 else 0
        put(mavlink.MAVLink_heartbeat_message(2, 3, 81 | armed, 0, 4 if armed else 3, 3))
        put(mavlink.MAVLink_system_time_message(1_790_000_000_000_000 + boot_ms * 1000, boot_ms))
        put(mavlink.MAVLink_attitude_message(boot_ms, 0.001, -0.001, 1.5, 0.0, 0.0, 0.0))
        entries.append(struct.pack(">Q", 1_790_000_000_000_000 + boot_ms * 1000) + _foreign(mav, system))
    file.write_bytes(b"".join(entries))


def _foreign(mav: Any, system: int) -> bytes:
    """MEMINFO (152) of ArduPilot's dialect, which is not in the common one. Its checksum has CRC_EXTRA 208."""
    from pymavlink.generator.mavcrc import x25crc

    payload = struct.pack("<HHI", 0, 65535, 131072).rstrip(b"\0")
    head = bytes([len(payload), 0, 0, mav.seq, system, 1, 152, 0, 0])
    mav.seq = (mav.seq + 1) % 256
    check = x25crc(head + payload + bytes([208])).crc
    return b"\xfd" + head + payload + struct.pack("<H", check)
