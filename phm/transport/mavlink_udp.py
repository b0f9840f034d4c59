"""MAVLink by UDP: to one peer, to a network, or waiting for peers that send. Part of `phm.transport.mavlink_channels`."""

from __future__ import annotations

import errno
import ipaddress
import socket
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from phm.core import polling
from phm.core.clock import Clock
from phm.transport.client_admission import ClientAdmission
from phm.transport.mavlink_channels import Channel
from phm.transport.mavlink_codec import Codec

PEER_EXPIRES_S = 60.0
DATAGRAMS_A_TURN, BYTES_A_TURN = 64, 16384
"""After the first of both is reached, the endpoint sends before it reads on: a flood must not stop its heartbeats."""
_BUSY = frozenset((errno.EAGAIN, errno.EWOULDBLOCK, errno.ENOBUFS))


class _Udp(Channel):
    """Common parts of all kinds of UDP: reads a limited number of datagrams at a time."""

    def __init__(self, sock: socket.socket, codec: Codec) -> None:
        self._socket, self._codec = sock, codec
        self._parser = codec.parser()

    def polls(self) -> list[tuple[int, int]]:
        return [(self._socket.fileno(), polling.READ)]

    def serve(self, fd: int, events: int) -> list[Any]:
        messages: list[Any] = []
        read = 0
        for _ in range(DATAGRAMS_A_TURN):
            if read >= BYTES_A_TURN:
                break
            try:
                data, sender = self._socket.recvfrom(65535)
            except BlockingIOError:
                break
            except OSError:
                continue  # an ICMP error about an earlier datagram, which any host on the path can cause; reading clears it
            read += len(data)
            messages += self._take(data, sender)
        return messages

    @abstractmethod
    def _take(self, data: bytes, sender: Any) -> list[Any]: ...

    @property
    def ready(self) -> bool:
        return True

    def close(self) -> None:
        self._socket.close()


class _Sending(_Udp):
    """Sends to one address, whether or not anything was received."""

    proven = False

    @abstractmethod
    def _send(self, frame: bytes) -> None:
        """Send a datagram. Raises OSError."""

    def write(self, frame: bytes) -> int:
        try:
            try:
                self._send(frame)
            except OSError as error:
                if error.errno in _BUSY:
                    raise
                # The kernel reports an ICMP error about an earlier datagram instead of sending this one.
                self._send(frame)
        except ConnectionError:
            return 1  # nothing listens there yet, which does not affect this channel
        except OSError as error:
            if error.errno in _BUSY:
                self._codec.counters.dropped += 1
                return 0
            raise
        return 1


class UdpOut(_Sending):
    """One peer, by a connected socket: the kernel drops datagrams of other senders."""

    def __init__(self, sock: socket.socket, codec: Codec) -> None:
        """sock: a connected socket."""
        super().__init__(sock, codec)
        self._peer = sock.getpeername()[:2]

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        # Data received between bind and connect of the socket, both within `connect`, may be from another sender.
        return self._parser.datagram(data) if sender[:2] == self._peer else []

    def _send(self, frame: bytes) -> None:
        self._socket.send(frame)


class UdpToHost(_Sending):
    """A program on the host of PHM's bridged container. The host has an address on each network: a program that listens on all of
    them is sent to at `target`, and answers from the gateway of PHM's network."""

    def __init__(self, sock: socket.socket, target: Any, gateway: Callable[[], str], codec: Codec) -> None:
        """gateway: its present address; it changes when PHM joins another network."""
        super().__init__(sock, codec)
        self._target, self._gateway = target, gateway

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        address, port = sender[:2]
        from_host = port == self._target[1] and (address == self._target[0] or address == self._gateway())
        return self._parser.datagram(data) if from_host else []

    def _send(self, frame: bytes) -> None:
        self._socket.sendto(frame, self._target)


class UdpBroadcast(_Sending):
    """All hosts of a network. They answer from the port on which they listen; datagrams from other ports or networks
    are dropped."""

    def __init__(self, sock: socket.socket, target: Any, codec: Codec) -> None:
        super().__init__(sock, codec)
        self._target, self._network = target, network_of(target[0])

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        if sender[1] != self._target[1] or ipaddress.ip_address(sender[0]) not in self._network:
            return []
        return self._parser.datagram(data)

    def _send(self, frame: bytes) -> None:
        self._socket.sendto(frame, self._target)


def network_of(broadcast: str) -> ipaddress.IPv4Network:
    """The largest network with this broadcast address. Its interface may not be up yet, so the mask is not requested."""
    number = int(ipaddress.IPv4Address(broadcast))
    host_bits = (~number & (number + 1)).bit_length() - 1
    return ipaddress.IPv4Network((number >> host_bits << host_bits, 32 - host_bits))


class UdpIn(_Udp):
    """Waits for peers and answers each that sent a frame with a correct checksum.

    `ClientAdmission` decides which peers are accepted if there are too many; frames of the others are read anyway.
    """

    def __init__(self, sock: socket.socket, codec: Codec, clock: Clock) -> None:
        super().__init__(sock, codec)
        self._clock = clock
        self._admission = ClientAdmission(signs=codec.signs)

    def _take(self, data: bytes, sender: Any) -> list[Any]:
        now, known = self._clock.mono(), sender in self._admission
        before = self._parser.verified
        messages = self._parser.datagram(data, verify=not known)
        signed = any(message.get_signed() for message in messages)
        if known:
            self._admission.receive(sender, now, signed=signed)
        elif self._parser.verified > before:
            self._admission.expire(now, PEER_EXPIRES_S)
            self._admission.admit(sender, sender[0], now, signed=signed)
        return messages

    def write(self, frame: bytes) -> int:
        self._admission.expire(self._clock.mono(), PEER_EXPIRES_S)
        sent = 0
        for peer in self._admission.peers:
            try:
                self._socket.sendto(frame, peer)
                sent += 1
            except OSError:  # one peer's network is gone; it expires unless it returns
                self._codec.counters.dropped += 1
        return sent
