"""UDP endpoints under a flood, over real sockets on loopback."""

from __future__ import annotations

import socket
from contextlib import closing

from phm.core import polling
from phm.core.clock import SystemClock
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_udp import BYTES_A_TURN, DATAGRAMS_A_TURN, UdpIn

SIZE = 8192


def test_a_turn_ends_after_a_limited_number_of_bytes() -> None:
    """Datagrams may have 64 kB: the endpoint must send between them, however many are waiting."""
    assert BYTES_A_TURN < SIZE * DATAGRAMS_A_TURN
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as sender:
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        codec = Codec(1, 193, lambda number: True)
        with closing(UdpIn(receiver, codec, SystemClock())) as channel:
            for _ in range(4):
                sender.sendto(bytes(SIZE), receiver.getsockname())
            channel.serve(receiver.fileno(), polling.READ)
            assert codec.counters.bytes_in == BYTES_A_TURN
            channel.serve(receiver.fileno(), polling.READ)
            assert codec.counters.bytes_in == 4 * SIZE
