"""A radio network of agents on loopback: each has a UDP port of the mesh as its endpoint; a test sets which agents receive each other."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Iterable
from typing import Any

from phm.transport.dialect import mavlink
from tests.fakes.mavlink import Sender, heartbeat

GROUND_S = 0.5
"""Between heartbeats of the ground station."""


class Mesh:
    """Members are identified by a name, so that two agents may use one id. Datagrams are forwarded unchanged to all receivers.

    `apart`: groups that do not receive each other. `no_gcs`: members without contact to the ground station.
    `ground` False: there is no ground station. `lines`: sender and text of each STATUSTEXT that it received.
    """

    def __init__(self, members: Iterable[str]) -> None:
        self.apart: tuple[frozenset[str], ...] = ()
        self.no_gcs: frozenset[str] = frozenset()
        self.ground = True
        self.lines: list[tuple[int, str]] = []
        self.payloads: list[tuple[int, bytes]] = []
        """Sender and content of each TUNNEL that it read."""
        self._sockets = {name: _bound() for name in members}
        self._received_at: dict[str, Any] = {}
        self._decoder, self._gcs = mavlink.MAVLink(None), Sender(255, 190)
        self._decoder.robust_parsing = True
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mesh", daemon=True)
        self._thread.start()

    def url(self, member: str) -> str:
        return f"udpout:127.0.0.1:{self._sockets[member].getsockname()[1]}"

    def close(self) -> None:
        self._stopping.set()
        self._thread.join(60)
        for sock in self._sockets.values():
            sock.close()

    def _run(self) -> None:
        of, due = {sock: name for name, sock in self._sockets.items()}, time.monotonic()
        while not self._stopping.is_set():
            for sock in select.select(list(of), [], [], 0.05)[0]:
                with contextlib.suppress(OSError):
                    data, self._received_at[of[sock]] = sock.recvfrom(65535)
                    self._forward(of[sock], data)
            if self.ground and time.monotonic() >= due:
                due = time.monotonic() + GROUND_S
                self._send(self._gcs.frame(heartbeat(kind=mavlink.MAV_TYPE_GCS)), set(of.values()) - self.no_gcs)

    def _forward(self, sender: str, data: bytes) -> None:
        receives = set(self._sockets) - {sender}
        if self.apart:
            receives &= next((group for group in self.apart if sender in group), frozenset())
        self._send(data, receives)
        if self.ground and sender not in self.no_gcs:
            for message in self._decoder.parse_buffer(data) or []:
                if message.get_type() == "STATUSTEXT":
                    self.lines.append((message.get_srcSystem(), message.text))
                elif message.get_type() == "TUNNEL":
                    self.payloads.append((message.get_srcSystem(), bytes(message.payload[: message.payload_length])))

    def _send(self, data: bytes, members: Iterable[str]) -> None:
        for name in members:
            if name in self._received_at:
                with contextlib.suppress(OSError):
                    self._sockets[name].sendto(data, self._received_at[name])


def _bound() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    return made
