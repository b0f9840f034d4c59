"""Non-blocking channels for MAVLink: TCP and serial here, UDP in `phm.transport.mavlink_udp`.

A channel belongs to the thread of its endpoint. It names the descriptors to poll, returns received messages,
and takes complete frames. OSError from any of its methods means that the channel is lost and must be reopened.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from phm.core import polling
from phm.core.clock import Clock
from phm.transport.client_admission import ClientAdmission
from phm.transport.mavlink_codec import Codec, Parser
from phm.transport.serial_errors import SerialErrorCount

READ_BYTES = 16384
"""Read from all clients of a server together before the endpoint sends, as by UDP: a flood must not stop its heartbeats."""
SEND_BUFFER_BYTES = 16384
CLIENT_BACKLOG_BYTES = 16384
"""A TCP client with a longer backlog loses frames; other clients do not."""


class Channel(ABC):
    """One open connection. `proven` False: being open proves nothing about the other side (UDP)."""

    proven = True

    @abstractmethod
    def polls(self) -> list[tuple[int, int]]:
        """Descriptors with the poll events to wait for."""

    @abstractmethod
    def serve(self, fd: int, events: int) -> list[Any]:
        """Process a ready descriptor. Returns the received messages."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether another frame is accepted now. Without a listener, frames are accepted and discarded: a ground
        station that connects later gets the full state."""

    @abstractmethod
    def write(self, frame: bytes) -> int:
        """Send a frame while `ready`. Returns the number of peers."""

    def line(self) -> SerialErrorCount | None:
        """Errors of the serial line; None if the driver does not count them."""
        return None

    @abstractmethod
    def close(self) -> None: ...


class Stream:
    """A byte stream with one peer: a TCP connection or a serial port, by its non-blocking descriptor and how to read and write it."""

    def __init__(self, fd: int, parser: Parser, read: Callable[[int], bytes], write: Callable[[bytes], int]) -> None:
        self.fd = fd
        self.pending = bytearray()
        self._parser, self._read, self._write = parser, read, write

    def mask(self) -> int:
        return polling.READ | (polling.WRITE if self.pending else 0)

    def serve(self, events: int, most: int = READ_BYTES) -> list[Any]:
        """Read at most `most` bytes. Raises OSError when the other side is gone. Data received before the end are still read."""
        if events & polling.WRITE:
            self.flush()
        if events & (polling.READ | polling.LOST):
            try:
                data = self._read(most)
            except BlockingIOError:
                if events & polling.LOST:
                    raise ConnectionResetError("the connection was lost") from None
                return []
            if not data:
                raise ConnectionResetError("the other side closed the connection")
            return self._parser.feed(data)
        return []

    def write(self, frame: bytes) -> None:
        self.pending += frame
        self.flush()

    def flush(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self.pending:
                del self.pending[: self._write(bytes(self.pending))]


class StreamChannel(Channel):
    """A channel of one stream. `owner` is closed with it: the socket or the serial port."""

    def __init__(self, owner: Any, stream: Stream) -> None:
        self._owner, self._stream = owner, stream

    def polls(self) -> list[tuple[int, int]]:
        return [(self._stream.fd, self._stream.mask())]

    def serve(self, fd: int, events: int) -> list[Any]:
        return self._stream.serve(events)

    @property
    def ready(self) -> bool:
        return not self._stream.pending

    def write(self, frame: bytes) -> int:
        self._stream.write(frame)
        return 1

    def close(self) -> None:
        with contextlib.suppress(OSError):  # it may be lost already, which is why it is closed
            self._owner.close()


class TcpServer(Channel):
    """Listens; every client receives everything.

    A client that does not read loses frames and affects no other. `ClientAdmission` decides which clients are accepted
    if there are too many.
    """

    def __init__(self, listener: socket.socket, codec: Codec, clock: Clock) -> None:
        self._listener, self._codec, self._clock = listener, codec, clock
        self._clients: dict[int, tuple[socket.socket, Stream]] = {}
        self._admission = ClientAdmission(signs=codec.signs, on_trial=codec.signs)

    def polls(self) -> list[tuple[int, int]]:
        for fd in self._admission.unproven(self._clock.mono()):
            self._drop(fd)
        clients = [(fd, stream.mask()) for fd, (_, stream) in self._clients.items()]
        return [(self._listener.fileno(), polling.READ), *clients]

    def serve(self, fd: int, events: int) -> list[Any]:
        if fd == self._listener.fileno():
            self._accept()
            return []
        if fd not in self._clients:
            return []
        try:
            messages = self._clients[fd][1].serve(events, READ_BYTES // len(self._clients))
        except OSError:
            self._drop(fd)
            return []
        if events & polling.READ:
            signed = any(message.get_signed() for message in messages)
            self._admission.receive(fd, self._clock.mono(), signed=signed)
        return messages

    @property
    def ready(self) -> bool:
        return True

    def write(self, frame: bytes) -> int:
        taken = 0
        for fd, (_, stream) in list(self._clients.items()):
            if len(stream.pending) > CLIENT_BACKLOG_BYTES:
                self._codec.counters.dropped += 1
                continue
            try:
                stream.write(frame)
                taken += 1
            except OSError:
                self._drop(fd)
        return taken

    def close(self) -> None:
        for fd in list(self._clients):
            self._drop(fd)
        self._listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            client, address = self._listener.accept()
            going = self._admission.admit(client.fileno(), address[0], self._clock.mono())
            if going is None:
                client.close()
                return
            for fd in going:
                self._drop(fd)
            tune(client)
            self._clients[client.fileno()] = (client, socket_stream(client, self._codec))

    def _drop(self, fd: int) -> None:
        client, _ = self._clients.pop(fd)
        self._admission.forget(fd)
        client.close()


def socket_stream(sock: socket.socket, codec: Codec) -> Stream:
    return Stream(sock.fileno(), codec.parser(), sock.recv, sock.send)


def tune(sock: socket.socket) -> None:
    """Non-blocking, without delay for small frames; a silent peer is disconnected after 10 s instead of 15 min.

    The kernel buffers little: megabytes of old lines behind a slow radio would be minutes of delay.
    """
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if sys.platform == "linux":
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 10_000)
