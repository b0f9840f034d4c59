"""The MAVLink router on board one agent, as a program: forwards between PHM and the agent's port of the link emulator.

``python3 -I -S router.py PORT HOST FAR_PORT`` listens on PORT while it is connected to FAR_PORT of HOST, where its
radio and its autopilot are (`sitl.simulation.link_emulator`); otherwise connections are refused. Uses the standard
library alone and imports little: there is one for each agent.
"""

from __future__ import annotations

import select
import signal
import socket
import sys
import time
from types import FrameType

RETRY_S = 0.2
CONNECT_S = 2.0
SEND_S = 1.0
"""A client that reads nothing for this time is disconnected: a router does not wait for it."""
BYTES = 65536


class PeerLost(Exception):
    """The connection to the link emulator has ended."""


class Router:
    """One client at a time, PHM; a later one replaces it. Data that arrive without a client are dropped."""

    def __init__(self, port: int, far: tuple[str, int]) -> None:
        self._port, self._far = port, far

    def run(self) -> None:
        """Run without end."""
        while True:
            try:
                self.carry(socket.create_connection(self._far, CONNECT_S))
            except (OSError, PeerLost):
                time.sleep(RETRY_S)

    def carry(self, far: socket.socket) -> None:
        """Forward until the far side is lost. Raises PeerLost."""
        with far, socket.create_server(("", self._port)) as door:
            far.settimeout(SEND_S)
            near: socket.socket | None = None
            try:
                while True:
                    watched = [far, door] if near is None else [far, door, near]
                    ready, _, _ = select.select(watched, [], [])
                    if door in ready:
                        near = _taken(door, near)
                    elif near is not None and near in ready:
                        near = self._up(near, far)
                    elif far in ready:
                        near = self._down(far, near)
            finally:
                if near is not None:
                    near.close()

    @staticmethod
    def _up(near: socket.socket, far: socket.socket) -> socket.socket | None:
        data = _read(near)
        if not data:
            near.close()
            return None
        try:
            far.sendall(data)
        except OSError as error:
            raise PeerLost from error
        return near

    @staticmethod
    def _down(far: socket.socket, near: socket.socket | None) -> socket.socket | None:
        data = _read(far)
        if not data:
            raise PeerLost
        if near is None:
            return None
        try:
            near.sendall(data)
        except OSError:
            near.close()
            return None
        return near


def _taken(door: socket.socket, before: socket.socket | None) -> socket.socket:
    near, _ = door.accept()
    near.settimeout(SEND_S)
    near.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if before is not None:
        before.close()
    return near


def _read(end: socket.socket) -> bytes:
    """Received data; empty when the connection has ended."""
    try:
        return end.recv(BYTES)
    except OSError:
        return b""


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(0)


def main(arguments: list[str]) -> int:
    if len(arguments) != 3:
        sys.stderr.write("router.py: give PORT HOST FAR_PORT\n")
        return 2
    # The first process of a container has no default signal handling.
    signal.signal(signal.SIGTERM, _leave)
    Router(int(arguments[0]), (arguments[1], int(arguments[2]))).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
