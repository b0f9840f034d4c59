"""Small MAVLink sockets for the simulated autopilot and ground station; independent of PHM's own transport.

Frames are forwarded as the received bytes. A port without space drops frames, as an autopilot does.
"""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import tty
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

os.environ["MAVLINK20"] = "1"  # pymavlink reads it when it is imported

from pymavlink.dialects.v20 import common as mavlink

__all__ = ["Port", "RemoteSystem", "mavlink"]

CONNECT_LIMIT_S = 2.0
_READ_BYTES = 65535


def parser() -> Any:
    """A pymavlink decoder that tolerates garbage."""
    decoder = mavlink.MAVLink(None)
    decoder.robust_parsing = True
    return decoder


def messages(decoder: Any, data: bytes) -> list[Any]:
    """Complete messages in `data`, without what pymavlink could not parse."""
    found = decoder.parse_buffer(data) or []
    return [message for message in found if message.get_type() != "BAD_DATA"]


class Pty:
    """A pseudo terminal at `path` in place of a serial port, with the methods of a socket that `Port` uses. The far end
    is kept open, so that it persists when programs open and close it.
    """

    def __init__(self, path: str) -> None:
        self._near, self._far = pty.openpty()
        tty.setraw(self._far)
        os.set_blocking(self._near, False)
        self.path = path
        with contextlib.suppress(FileNotFoundError):
            os.unlink(path)
        os.symlink(os.ttyname(self._far), path)

    def fileno(self) -> int:
        return self._near

    def setblocking(self, flag: bool) -> None:
        os.set_blocking(self._near, flag)

    def recv(self, size: int) -> bytes:
        return os.read(self._near, size)

    def send(self, frame: bytes) -> int:
        return os.write(self._near, frame)

    def close(self) -> None:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(self.path)
        os.close(self._near)
        os.close(self._far)


@dataclass
class RemoteSystem:
    """The other end of a connection. `spoken`: a frame was received from there."""

    sock: Any
    address: Any = None
    decoder: Any = field(default_factory=parser)
    spoken: bool = False

    def send(self, frame: bytes) -> bool:
        """Send a frame; False when the connection is lost. A frame without space is dropped."""
        try:
            if self.address is not None:
                self.sock.sendto(frame, self.address)
                return True
            return bool(self.sock.send(frame) == len(frame))  # an incomplete frame would corrupt the stream
        except BlockingIOError:
            return True
        except OSError:
            return self.address is not None


class Port:
    """``udpin:HOST:PORT``, ``tcpin:HOST:PORT``, ``udpout:HOST:PORT``, ``tcp:HOST:PORT``, or ``pty:PATH``, a serial
    port.

    Raises OSError when it cannot be opened. `lost` is set when the other end of a ``tcp:`` port disconnected.
    """

    def __init__(self, url: str) -> None:
        self.scheme, _, rest = url.partition(":")
        self.peers: dict[Hashable, RemoteSystem] = {}
        self.lost = False
        self._interrupted = False
        self._main: Any
        if self.scheme == "pty":
            self._main = Pty(rest)
            self.peers[self._main] = RemoteSystem(self._main)
            return
        host, _, port = rest.rpartition(":")
        address = (host.strip("[]"), int(port))
        if self.scheme in ("udpin", "udpout"):
            self._main = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            if self.scheme == "udpin":
                self._main.bind(address)
            else:
                self.peers[address] = RemoteSystem(self._main, address, spoken=True)
        elif self.scheme == "tcpin":
            self._main = socket.create_server(address)
        elif self.scheme == "tcp":
            self._main = socket.create_connection(address, CONNECT_LIMIT_S)
            self._main.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.peers[self._main] = RemoteSystem(self._main)
        else:
            raise OSError(f"{url!r}: use udpin:, udpout:, tcpin: or tcp: with a host and a port, or pty:PATH")
        self._main.setblocking(False)

    def interrupt(self) -> None:
        """As in a reboot: TCP connections close, new ones are refused until `resume`, and no peer has sent a frame."""
        for key in list(self.peers):
            if self.scheme == "tcpin":
                self._drop(key)
            else:
                self.peers[key].spoken = False
        if self.scheme == "tcpin" and not self._interrupted:
            address = self._main.getsockname()
            self._main.close()
            self._main = socket.socket()
            self._main.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._main.bind(address)  # refuses connections without `listen`, and no other program takes the port
            self._interrupted = True

    def resume(self) -> None:
        """End `interrupt`."""
        if self._interrupted:
            self._main.listen()
            self._main.setblocking(False)
            self._interrupted = False

    @property
    def bound_port(self) -> int:
        """The port that was actually bound, for port 0 in the URL."""
        return int(self._main.getsockname()[1])

    def sockets(self) -> list[Any]:
        """The sockets to select on."""
        if self._interrupted:
            return []
        clients = [peer.sock for peer in self.peers.values() if peer.sock is not self._main]
        return [self._main, *clients]

    def receive(self, sock: Any) -> list[tuple[Hashable, Any]]:
        """Messages, each with the key of the peer that sent it."""
        if self.scheme.startswith("udp"):
            return self._datagram()
        if self.scheme == "tcpin" and sock is self._main:
            with contextlib.suppress(BlockingIOError):
                client, _ = sock.accept()
                client.setblocking(False)
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self.peers[client] = RemoteSystem(client)
            return []
        peer = self.peers.get(sock)
        if peer is None:
            return []
        try:
            data = sock.recv(_READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop(sock)
            return []
        return self._received(sock, peer, data)

    def send(self, frame: bytes, *, spoken_only: bool = False, but: Hashable = None) -> None:
        """Send to every peer except `but`; `spoken_only` leaves out those that never sent a frame."""
        for key, peer in list(self.peers.items()):
            if key != but and (peer.spoken or not spoken_only) and not peer.send(frame):
                self._drop(key)

    def close(self) -> None:
        for sock in {self._main, *self.sockets()}:
            sock.close()

    def _datagram(self) -> list[tuple[Hashable, Any]]:
        try:
            data, sender = self._main.recvfrom(_READ_BYTES)
        except OSError:
            return []
        peer = self.peers.get(sender)
        if peer is None:
            if self.scheme == "udpout":
                peer = next(iter(self.peers.values()))
            else:
                peer = self.peers[sender] = RemoteSystem(self._main, sender)
                while len(self.peers) > 16:
                    self.peers.pop(next(iter(self.peers)))
        return self._received(sender, peer, data)

    @staticmethod
    def _received(key: Hashable, peer: RemoteSystem, data: bytes) -> list[tuple[Hashable, Any]]:
        found = messages(peer.decoder, data)
        peer.spoken = peer.spoken or bool(found)
        return [(key, message) for message in found]

    def _drop(self, key: Hashable) -> None:
        peer = self.peers.pop(key, None)
        if peer is not None:
            peer.sock.close()
        self.lost = self.lost or self.scheme == "tcp"
