"""Opens MAVLink channels from pymavlink's connection strings, with a deadline on every step."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from phm.core import polling
from phm.core.clock import Clock
from phm.core.settings import EndpointSettings
from phm.transport.dns import Address, Resolver
from phm.transport.mavlink_channels import Channel, Stream, StreamChannel, TcpServer, socket_stream, tune
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_udp import UdpBroadcast, UdpIn, UdpOut, UdpToHost
from phm.transport.own_network import HOST_NAME, gateway, is_private
from phm.transport.serial_errors import SerialErrorCount, drop_output, keep_dtr, place, read_counts

CONNECT_LIMIT_S = 5.0
RESOLVE_LIMIT_S = 5.0
_SLICE_S = 0.1
"""How soon an opening is cancelled."""


class ChannelOpener:
    """Opens the channel of one endpoint. `open` runs in the endpoint's thread, and returns early when `enough` is set."""

    def __init__(
        self, settings: EndpointSettings, codec: Codec, clock: Clock, enough: threading.Event, dev_root: str = "/dev"
    ) -> None:
        self._settings, self._codec, self._clock, self._enough = settings, codec, clock, enough
        self._dev_root = dev_root
        self._scheme = "serial"
        self._resolver: Resolver | None = None
        self._target: Address | None = None
        self._source = ""
        """Own address at which the route to the UDP peer begins."""
        self._to_host = False
        """Whether the peer is the host, by name."""
        if not settings.url.startswith("/"):
            self._scheme, _, rest = settings.url.partition(":")
            host, _, port = rest.rpartition(":")
            self._to_host = host == HOST_NAME
            kind = socket.SOCK_STREAM if self._scheme.startswith("tcp") else socket.SOCK_DGRAM
            self._resolver = Resolver(host, int(port), kind, passive=self._scheme.endswith("in"))

    def moved(self) -> bool:
        """Whether the peer's name no longer has the address in use (its container was restarted), or the route begins at another
        address of this machine (another interface is in use).

        It resolves the name in the background and returns the result of earlier look-ups. For `udpout` only: TCP
        detects this by itself.
        """
        if self._scheme != "udpout" or self._resolver is None:
            return False
        if self._rerouted():
            return True
        if self._resolver.literal:
            return False
        self._resolver.ask()
        newest = self._resolver.newest()
        return bool(newest) and self._target not in newest

    def open(self) -> Channel:
        """A new channel. Raises OSError with a sentence for the log."""
        makers: dict[str, Callable[[], Channel]] = {
            "serial": self._serial,
            "tcp": self._tcp,
            "tcpin": self._tcpin,
            "udpin": self._udpin,
            "udpout": self._udpout,
            "udpbcast": self._udpbcast,
        }
        return makers[self._scheme]()

    def _address(self) -> Address:
        return self._ipv4_first()[0]

    def _ipv4_first(self) -> tuple[Address, ...]:
        """UDP does not show that nothing listens at an address, and MAVLink programs listen on IPv4."""
        return tuple(sorted(self._addresses(), key=lambda address: address[0] != socket.AF_INET))

    def _addresses(self) -> tuple[Address, ...]:
        assert self._resolver is not None
        done = self._resolver.ask()
        end = self._clock.mono() + RESOLVE_LIMIT_S
        while not done.is_set() and not self._enough.is_set() and self._clock.mono() < end:
            done.wait(_SLICE_S)
        return self._resolver.answers()

    def _tcp(self) -> Channel:
        return self._first_open(self._addresses(), self._connect)

    def _first_open(self, addresses: Iterable[Address], connect: Callable[[Address], Channel]) -> Channel:
        """A channel to the first address that can be used. Raises the refusal if one refused, because its cause is clear."""
        problems: list[OSError] = []
        for address in addresses:
            try:
                return connect(address)
            except OSError as error:
                problems.append(error)
            if self._enough.is_set():
                break
        raise min(problems, key=lambda problem: problem.errno != errno.ECONNREFUSED)

    def _connect(self, address: Address) -> Channel:
        family, target = address
        sock = socket.socket(family, socket.SOCK_STREAM)
        with _closed_on_failure(sock):
            tune(sock)
            problem = sock.connect_ex(target)
            if problem in (errno.EINPROGRESS, errno.EWOULDBLOCK):  # the second one on Windows
                problem = self._connected(sock)
            if problem:
                raise OSError(problem, os.strerror(problem))
        return StreamChannel(sock, socket_stream(sock, self._codec))

    def _connected(self, sock: socket.socket) -> int:
        """The error number of a connection in progress, 0 when it is established."""
        end = self._clock.mono() + CONNECT_LIMIT_S
        while not self._enough.is_set() and self._clock.mono() < end:
            if polling.wait([(sock.fileno(), polling.WRITE)], _SLICE_S):
                return sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        return errno.ETIMEDOUT

    def _tcpin(self) -> Channel:
        family, address = self._address()
        sock = socket.socket(family, socket.SOCK_STREAM)
        with _closed_on_failure(sock):
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            sock.bind(address)
            sock.listen(8)
        return TcpServer(sock, self._codec, self._clock)

    def _udpin(self) -> Channel:
        family, address = self._address()
        sock = socket.socket(family, socket.SOCK_DGRAM)
        with _closed_on_failure(sock):
            sock.setblocking(False)
            sock.bind(address)
        return UdpIn(sock, self._codec, self._clock)

    def _udpout(self) -> Channel:
        return self._first_open(self._ipv4_first(), self._send_to)

    def _send_to(self, address: Address) -> Channel:
        self._target = address
        family, target = address
        sock = socket.socket(family, socket.SOCK_DGRAM)
        with _closed_on_failure(sock):
            sock.setblocking(False)
            self._source = _source(family, target)
            if self._to_host and family == socket.AF_INET and is_private():
                return UdpToHost(sock, target, gateway, self._codec)
            sock.connect(target)
            return UdpOut(sock, self._codec)

    def _udpbcast(self) -> Channel:
        family, target = self._address()
        sock = socket.socket(family, socket.SOCK_DGRAM)
        with _closed_on_failure(sock):
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            return UdpBroadcast(sock, target, self._codec)

    def _rerouted(self) -> bool:
        """Whether the route to the peer now begins at another address of this machine: a connected socket keeps its
        first one."""
        assert self._target is not None
        with contextlib.suppress(OSError):
            return _source(*self._target) != self._source
        return False

    def _serial(self) -> Channel:
        if sys.platform == "win32":
            raise OSError(
                errno.ENOTSUP,
                f"{self._settings.url}: PHM opens no serial ports on Windows: have a ground station forward by UDP",
            )
        # Imported here: an agent without serial endpoints needs no pyserial.
        import serial

        try:
            # exclusive: two readers of one port take each other's bytes, and both seem broken.
            path = place(self._settings.url, self._dev_root)
            port = serial.Serial(path, self._settings.baud, timeout=0, write_timeout=0, exclusive=True)
        except ValueError as error:  # a baud rate that the driver refuses
            raise OSError(f"{self._settings.url}: {error}") from error
        keep_dtr(port.fileno())
        return SerialChannel(port, self._codec)


def _source(family: int, target: Any) -> str:
    """Own address from which the route to a UDP peer begins. Raises OSError without a route."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(target)  # UDP: nothing is sent
        return str(probe.getsockname()[0])


@contextlib.contextmanager
def _closed_on_failure(sock: socket.socket) -> Iterator[None]:
    try:
        yield
    except BaseException:  # raised again; only the socket must not be left open
        sock.close()
        raise


class SerialChannel(StreamChannel):
    """A serial port. Unsent data are discarded at the end: a stuck port would block `close`."""

    def __init__(self, port: Any, codec: Codec) -> None:
        fd = port.fileno()
        super().__init__(port, Stream(fd, codec.parser(), partial(os.read, fd), partial(os.write, fd)))

    def line(self) -> SerialErrorCount | None:
        return read_counts(self._owner.fileno())

    def close(self) -> None:
        drop_output(self._owner)
        super().close()
