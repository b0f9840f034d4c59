"""Checks whether an address responds, without privileges and within a second.

An ICMP echo through a datagram socket needs no capability where `net.ipv4.ping_group_range` permits it, as Docker does
for containers by default. In parallel PHM opens a TCP connection to an unused port: a refusal also proves that the
address responds.
"""

from __future__ import annotations

import errno
import ipaddress
import os
import select
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path

from phm.facts import CannotTell

LIMIT_S = 1.0
"""Timeout for an address with few known response times."""
LEAST_S, TIMES = 0.25, 4
"""The timeout of an address that has responded: TIMES times its longest recent response time, at least LEAST_S. On a
bridge of this machine the kernel responds within 0.1 ms. A longer time is usually PHM waiting for a core, and a
response that has arrived by then counts."""
LEARNED = 5
"""Number of responses needed to know their duration."""
_FADES = 0.95
MOST_REMEMBERED = 256
_DISCARD_PORT = 9
_COMPLETE = 0x2  # ATF_COM in /proc/net/arp: the address has responded with its hardware address


class Pinger:
    """Remembers which addresses responded, and in which run of their container.

    An address that responded and no longer does is silent, regardless of ARP: the kernel remembers a departed neighbour
    for up to a minute. So ARP counts only for an address that has never responded, behind a firewall. Thread-safe: each
    call writes at most one entry.
    """

    def __init__(
        self, ping: Callable[[str, float], bool] | None = None, known: Callable[[str], bool] | None = None
    ) -> None:
        self._ping, self._known = ping or _ping, known or _neighbour
        self._answered: dict[str, str] = {}
        self._took: dict[str, tuple[int, float]] = {}

    def answers(self, address: str, generation: str = "") -> bool:
        """`generation`: the run of the container that has the address. Raises CannotTell like `answers`."""
        if self.ping(address):
            if len(self._answered) >= MOST_REMEMBERED:
                self._answered.clear()
            self._answered[address] = generation
            return True
        return self._answered.get(address) != generation and self._known(address)

    def ping(self, address: str) -> bool:
        """Whether it responds to a request, within its timeout. Raises CannotTell like `answers`."""
        began = time.monotonic()
        there = self._ping(address, self.limit_s(address))
        if there:
            if address not in self._took and len(self._took) >= MOST_REMEMBERED:
                self._took.clear()
            number, longest_s = self._took.get(address, (0, 0.0))
            self._took[address] = (number + 1, max(time.monotonic() - began, longest_s * _FADES))
        return there

    def has_responded(self, address: str, generation: str) -> bool:
        """Whether it has responded in this run of its container."""
        return self._answered.get(address) == generation

    def limit_s(self, address: str) -> float:
        """The timeout of the address, in seconds."""
        number, longest_s = self._took.get(address, (0, 0.0))
        return min(LIMIT_S, max(LEAST_S, TIMES * longest_s)) if number >= LEARNED else LIMIT_S


def answers(address: str) -> bool:
    """Raises CannotTell if `address` is not an IP address or this machine cannot open sockets."""
    return _ping(address) or _neighbour(address)


def _ping(address: str, limit_s: float = LIMIT_S) -> bool:
    """Whether it responds to a request, by ICMP or TCP."""
    try:
        version = ipaddress.ip_address(address).version
    except ValueError as error:
        raise CannotTell(f"{address!r} is not an IP address") from error
    family = socket.AF_INET if version == 4 else socket.AF_INET6
    try:
        with socket.socket(family, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as tcp:
            echo = _echo(family, address)
            try:
                return _any_answers(tcp, echo, address, limit_s)
            finally:
                if echo is not None:
                    echo.close()
    except OSError as error:
        raise CannotTell(f"{address} cannot be reached from here: {error}") from error


def _echo(family: socket.AddressFamily, address: str) -> socket.socket | None:
    """A socket on which an echo request was sent; None if that is not permitted."""
    protocol = socket.IPPROTO_ICMP if family == socket.AF_INET else socket.IPPROTO_ICMPV6
    request = 8 if family == socket.AF_INET else 128
    try:
        echo = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK, protocol)
    except OSError:
        return None
    try:
        echo.connect((address, 0))
        # The kernel sets the identifier and the checksum.
        echo.send(struct.pack("!BBHHH", request, 0, 0, 0, 1) + b"phm")
    except OSError:
        echo.close()
        return None
    return echo


def _any_answers(tcp: socket.socket, echo: socket.socket | None, address: str, limit_s: float) -> bool:
    """Whether either responds; False when both are refused or the time is over."""
    started = tcp.connect_ex((address, _DISCARD_PORT))
    if started in (0, errno.ECONNREFUSED):
        return True
    poll = select.poll()
    open_ends: dict[int, socket.socket] = {}
    if started == errno.EINPROGRESS:
        open_ends[tcp.fileno()] = tcp
        poll.register(tcp, select.POLLOUT)
    if echo is not None:
        open_ends[echo.fileno()] = echo
        poll.register(echo, select.POLLIN)
    until = time.monotonic() + limit_s
    while open_ends:
        left = until - time.monotonic()
        # Also after the timeout: on a busy machine PHM may run too late to see a response in time.
        for number, _ in poll.poll(max(0.0, left * 1000)):
            end = open_ends.pop(number)
            poll.unregister(number)
            if _proof(end, end is echo):
                return True
        if left <= 0:
            break
    return False


def _proof(end: socket.socket, is_echo: bool) -> bool:
    if not is_echo:
        return end.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) in (0, errno.ECONNREFUSED)
    try:
        return bool(end.recv(256))  # connected, so only replies of that address arrive
    except OSError:
        return False


def _neighbour(address: str) -> bool:
    """Whether the address responded to ARP recently: it exists, although a firewall drops PHM's packets.

    The kernel asks a neighbour again up to 45 s after its last response, and forgets it eight seconds later.
    """
    try:
        lines = Path(f"/proc/{os.getpid()}/net/arp").read_text(encoding="ascii", errors="replace").splitlines()[1:]
    except OSError:
        return False
    return any(
        fields[0] == address and int(fields[2], 16) & _COMPLETE and fields[3].strip("0:")
        for fields in map(str.split, lines)
        if len(fields) >= 4
    )
