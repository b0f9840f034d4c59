"""A ground station on this machine, for PHM in a container."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

from phm.transport.dialect import mavlink
from tests.fakes.mavlink import Sender, heartbeat


class Ground:
    """Listens on all addresses of the machine, and answers each datagram with a HEARTBEAT.

    heartbeats: (system, component) of each received HEARTBEAT.
    """

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self.port: int = sock.getsockname()[1]
        self.heartbeats: set[tuple[int, int]] = set()

    def serve(self, stop: threading.Event) -> None:
        parser, sender = mavlink.MAVLink(None), Sender(255, 190)
        while not stop.is_set():
            with contextlib.suppress(TimeoutError):
                data, peer = self._socket.recvfrom(2048)
                for message in parser.parse_buffer(data) or ():
                    if message.get_type() == "HEARTBEAT":
                        self.heartbeats.add((message.get_srcSystem(), message.get_srcComponent()))
                self._socket.sendto(sender.frame(heartbeat(kind=mavlink.MAV_TYPE_GCS)), peer)


@contextlib.contextmanager
def ground_station() -> Iterator[Ground]:
    """One at a free UDP port, in a thread."""
    stop = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("0.0.0.0", 0))
        sock.settimeout(0.2)
        station = Ground(sock)
        thread = threading.Thread(target=station.serve, args=(stop,), name="ground", daemon=True)
        thread.start()
        try:
            yield station
        finally:
            stop.set()
            thread.join(60)
