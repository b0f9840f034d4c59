"""Clients of `tcpin` that send all the time: the endpoint sends between their data, and reads all of them."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import pytest

from phm.core import polling
from phm.testing import FakeClock
from phm.transport.client_admission import MAX_PEERS, PER_ADDRESS
from phm.transport.mavlink_channels import READ_BYTES, TcpServer
from phm.transport.mavlink_codec import Codec
from tests.fakes.until import until


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0), backlog=MAX_PEERS) as made:
        made.setblocking(False)
        yield made


@pytest.mark.parametrize("clients", [1, MAX_PEERS])
def test_clients_share_what_is_read_in_a_turn(listener: socket.socket, clients: int) -> None:
    """Else many of them would delay heartbeats: each of these bytes may begin a frame, whose checksum is computed in Python."""
    codec = Codec(7, 193, lambda number: True)
    server, counters = TcpServer(listener, codec, FakeClock()), codec.counters
    with contextlib.ExitStack() as stack:
        stack.callback(server.close)
        for number in range(clients):
            source = (f"127.0.0.{1 + number // PER_ADDRESS}", 0)
            client = stack.enter_context(socket.create_connection(listener.getsockname(), source_address=source))
            client.sendall(bytes(READ_BYTES))
            until(lambda: polling.wait(server.polls()[:1], 0.1), "the connection")
            server.serve(*server.polls()[0])
        until(lambda: len(polling.wait(server.polls()[1:], 0.1)) == clients, "the data of all")
        for fd, events in polling.wait(server.polls()[1:], 0.1):
            before = counters.bytes_in
            server.serve(fd, events)
            assert counters.bytes_in > before
    assert counters.bytes_in <= READ_BYTES
