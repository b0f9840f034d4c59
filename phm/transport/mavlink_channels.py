"""The ways MAVLink bytes travel: UDP, TCP and serial, none of them ever blocking.

A channel belongs to the thread of its endpoint. It says which descriptors to poll, gives the messages
that came in, and takes whole frames. OSError from any of its methods means: it is lost, open it anew.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
from abc import ABC, abstractmethod
from typing import Any

from phm.clock import Clock
from phm.transport.mavlink_codec import Codec, Parser
from phm.transport.serial_line import LineCount

MAX_PEERS = 16
PEER_EXPIRES_S = 60.0
READ_BYTES = 16384
DATAGRAMS_A_TURN = 64
SEND_BUFFER_BYTES = 16384
CLIENT_BACKLOG_BYTES = 16384
"""A TCP client that is this far behind loses frames, and nobody else does."""
_BUSY = frozenset((errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOBUFS))
_POLL_LOST = select.POLLERR | select.POLLHUP | select.POLLNVAL


class Channel(ABC):
    """One open connection. `proven` False: being open says nothing about the other side (sending by UDP)."""

    proven = True

    @abstractmethod
    def polls(self) -> list[tuple[int, int]]:
        """Descriptors with the poll events waited for."""

    @abstractmethod
    def serve(self, fd: int, events: int) -> list[Any]:
        """Do what a descriptor is ready for; the messages that came in."""

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether another frame is taken now. Where nobody listens, frames are taken and go nowhere: whoever
        comes later is told the full state, not what was."""

    @abstractmethod
    def write(self, frame: bytes) -> int:
        """Take a frame while `ready`; to how many it went."""

    def line(self) -> LineCount | None:
        """Errors on the line, where there is one whose driver counts them."""
        return None

    @abstractmethod
    def close(self) -> None: ...


class Stream:
    """A byte stream with one peer: a TCP connection or a serial port, by its non-blocking descriptor."""

    def __init__(self, fd: int, parser: Parser) -> None:
        self.fd = fd
        self.pending = bytearray()
        self._parser = parser

    def mask(self) -> int:
        return select.POLLIN | (select.POLLOUT if self.pending else 0)

    def serve(self, events: int) -> list[Any]:
        """Raises OSError when the other side is gone. What came before the end is still read."""
        if events & select.POLLOUT:
            self.flush()
        if events & (select.POLLIN | _POLL_LOST):
            try:
                data = os.read(self.fd, READ_BYTES)
            except BlockingIOError:
                if events & _POLL_LOST:
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
                del self.pending[: os.write(self.fd, self.pending)]


class StreamChannel(Channel):
    """A channel of one stream. `owner` is closed with it: the socket or the serial port."""

    def __init__(self, owner: Any, fd: int, codec: Codec) -> None:
        self._owner, self._stream = owner, Stream(fd, codec.parser())

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
    """Listens; every client hears everything. A client that does not read loses frames and harms nobody."""

    def __init__(self, listener: socket.socket, codec: Codec) -> None:
        self._listener, self._codec = listener, codec
        self._clients: dict[int, tuple[socket.socket, Stream]] = {}

    def polls(self) -> list[tuple[int, int]]:
        clients = [(fd, stream.mask()) for fd, (_, stream) in self._clients.items()]
        return [(self._listener.fileno(), select.POLLIN), *clients]

    def serve(self, fd: int, events: int) -> list[Any]:
        if fd == self._listener.fileno():
            self._accept()
            return []
        if fd not in self._clients:
            return []
        try:
            return self._clients[fd][1].serve(events)
        except OSError:
            self._drop(fd)
            return []

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
            client, _ = self._listener.accept()
            if len(self._clients) >= MAX_PEERS:
                client.close()
                return
            tune(client)
            self._clients[client.fileno()] = (client, Stream(client.fileno(), self._codec.parser()))

    def _drop(self, fd: int) -> None:
        client, _ = self._clients.pop(fd)
        client.close()


class _Udp(Channel):
    """What both kinds of UDP share: reading a bounded number of datagrams at a time."""

    def __init__(self, sock: socket.socket, codec: Codec) -> None:
        self._socket, self._codec = sock, codec
        self._parser = codec.parser()

    def polls(self) -> list[tuple[int, int]]:
        return [(self._socket.fileno(), select.POLLIN)]

    def serve(self, fd: int, events: int) -> list[Any]:
        messages: list[Any] = []
        for _ in range(DATAGRAMS_A_TURN):
            try:
                data, sender = self._socket.recvfrom(65535)
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # an earlier datagram found nobody listening: no news about this channel
            messages += self._take(data, sender)
        return messages

    @abstractmethod
    def _take(self, data: bytes, sender: Any) -> list[Any]: ...

    def close(self) -> None:
        self._socket.close()


class UdpOut(_Udp):
    """Sends to one address, or to all of a network, whether or not anybody was heard."""

    proven = False

    def __init__(self, sock: socket.socket, target: Any, codec: Codec) -> None:
        super().__init__(sock, codec)
        self._target = target

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        return self._parser.datagram(data)

    @property
    def ready(self) -> bool:
        return True

    def write(self, frame: bytes) -> int:
        try:
            self._socket.sendto(frame, self._target)
        except ConnectionError:
            return 1  # ECONNREFUSED tells of an earlier datagram; this one may well arrive
        except OSError as error:
            if error.errno in _BUSY:
                self._codec.counters.dropped += 1
                return 0
            raise
        return 1


class UdpIn(_Udp):
    """Waits for peers and answers to each that sent a frame whose checksum is right."""

    def __init__(self, sock: socket.socket, codec: Codec, clock: Clock) -> None:
        super().__init__(sock, codec)
        self._clock = clock
        self._peers: dict[Any, float] = {}

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        known = sender in self._peers
        before = self._parser.verified
        messages = self._parser.datagram(data, verify=not known)
        if known or (self._parser.verified > before and self._room()):
            self._peers[sender] = self._clock.mono()
        return messages

    def _room(self) -> bool:
        self._expire()
        return len(self._peers) < MAX_PEERS

    def _expire(self) -> None:
        now = self._clock.mono()
        self._peers = {peer: heard for peer, heard in self._peers.items() if now - heard <= PEER_EXPIRES_S}

    @property
    def ready(self) -> bool:
        return True

    def write(self, frame: bytes) -> int:
        self._expire()
        sent = 0
        for peer in self._peers:
            try:
                self._socket.sendto(frame, peer)
                sent += 1
            except OSError:  # one peer's network is gone; it expires unless it comes back
                self._codec.counters.dropped += 1
        return sent


def tune(sock: socket.socket) -> None:
    """Non-blocking, small frames at once, and a silent other end is given up after 10 s instead of 15 min.

    The kernel keeps little: megabytes of old lines behind a slow radio would be minutes of delay.
    """
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, 10_000)
