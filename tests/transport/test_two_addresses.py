"""Names with several addresses, where the program listens on one of them: `localhost` with `::1` first, a router of two networks."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import EndpointSettings
from phm.testing import settings
from phm.transport import mavlink_connection
from phm.transport.mavlink_channels import Channel
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_connection import ChannelOpener
from tests.fakes.mavlink import free_port
from tests.fakes.until import until

V6, V4 = "::1", "127.0.0.1"
NAME = "router.test"


@pytest.fixture
def named(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The addresses of NAME, in the order in which the name server gives them."""
    addresses, real = [V6, V4], socket.getaddrinfo

    def resolve(host: str, port: int | None, type: int = 0, flags: int = 0) -> Sequence[Any]:
        if host != NAME:
            return real(host, port, type=type, flags=flags)
        if flags & socket.AI_NUMERICHOST:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [one for each in addresses for one in real(each, port, type=type, flags=flags)]

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    return addresses


def opener(url: str, enough: threading.Event | None = None) -> ChannelOpener:
    (entry,) = settings(mavlink={"endpoints": [{"url": url}]}).mavlink.endpoints
    assert isinstance(entry, EndpointSettings)
    return ChannelOpener(entry, Codec(1, 193, lambda number: True), SystemClock(), enough or threading.Event())


@contextlib.contextmanager
def opened(made: ChannelOpener) -> Iterator[Channel]:
    channel = made.open()
    try:
        yield channel
    finally:
        channel.close()


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server((V4, 0)) as listener:
        listener.settimeout(60.0)
        yield listener


def test_tcp_tries_the_next_address_after_a_refusal(named: list[str], server: socket.socket) -> None:
    """The router listens on IPv4 alone."""
    with opened(opener(f"tcp:{NAME}:{server.getsockname()[1]}")):
        server.accept()[0].close()


def test_tcp_tries_the_next_address_after_the_deadline(
    named: list[str], server: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first one belongs to a network that drops everything; each address has the whole deadline."""
    waits = [errno.ETIMEDOUT, 0]
    monkeypatch.setattr(ChannelOpener, "_connected", lambda self, sock: waits.pop(0))
    named[:] = [V4, V4]
    with opened(opener(f"tcp:{NAME}:{server.getsockname()[1]}")):
        assert waits == []


def test_tcp_without_any_listener_is_refused(named: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """A refusal is what the operator can act on, whichever address it was."""
    real = ChannelOpener._connect

    def connect(self: ChannelOpener, address: Any) -> Channel:
        if address[0] == socket.AF_INET6:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")
        return real(self, address)

    monkeypatch.setattr(ChannelOpener, "_connect", connect)
    with pytest.raises(ConnectionRefusedError):
        opener(f"tcp:{NAME}:{free_port()}").open()


def test_an_opening_that_is_cancelled_tries_no_further_address(
    named: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """PHM stops, or the container at the other end has just started."""
    enough, tried = threading.Event(), list[Any]()

    def connect(self: ChannelOpener, address: Any) -> Channel:
        tried.append(address)
        enough.set()
        raise TimeoutError(errno.ETIMEDOUT, "timed out")

    monkeypatch.setattr(ChannelOpener, "_connect", connect)
    with pytest.raises(TimeoutError):
        opener(f"tcp:{NAME}:5760", enough).open()
    assert len(tried) == 1


@pytest.mark.parametrize("order", [[V6, V4], [V4, V6]])
def test_udp_sends_to_the_ipv4_address(named: list[str], order: list[str]) -> None:
    """An open UDP socket does not show that nothing listens, and MAVLink programs listen on IPv4."""
    named[:] = order
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind((V4, 0))
        ground.settimeout(60.0)
        with opened(opener(f"udpout:{NAME}:{ground.getsockname()[1]}")) as channel:
            channel.write(b"hello")
            assert ground.recv(100) == b"hello"


@pytest.mark.parametrize(
    ("addresses", "tried"), [([V6], [V6]), ([V6, V4], [V4, V6]), ([V4, V6], [V4, V6]), ([V4], [V4])]
)
def test_udp_tries_the_ipv6_address_without_a_route_to_the_other(
    named: list[str], addresses: list[str], tried: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a network without IPv4 a name may still have an address of it. No IPv6 is needed here: nothing is sent."""
    named[:] = addresses
    seen: list[str] = []

    def unreachable(self: ChannelOpener, address: Any) -> Channel:
        seen.append(address[1][0])
        raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(ChannelOpener, "_send_to", unreachable)
    with pytest.raises(OSError, match="unreachable"):
        opener(f"udpout:{NAME}:14550").open()
    assert seen == tried


def test_a_udp_peer_has_moved_when_its_address_is_not_named_any_more(
    named: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not when a name server gives the same addresses in another order."""
    monkeypatch.setattr(mavlink_connection, "_source", lambda family, target: V4)
    made = opener(f"udpout:{NAME}:14550")
    named[:] = [V4]
    with opened(made):
        for addresses, moved in (([V4, "127.0.0.2"], False), (["127.0.0.2", V4], False), (["127.0.0.2"], True)):
            named[:] = addresses
            until(lambda expected=addresses: _looked_up(made) == expected)  # type: ignore[misc]
            assert made.moved() is moved


def _looked_up(made: ChannelOpener) -> list[str]:
    """The newest addresses, after asking for newer ones."""
    assert made._resolver is not None
    made._resolver.ask()
    return [address[0] for _, address in made._resolver.newest()]
