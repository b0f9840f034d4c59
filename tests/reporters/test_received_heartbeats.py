"""Which heartbeats of others are logged, so that clocks can be compared after the flight."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from phm.reporters.base import MavlinkSender
from phm.reporters.received_heartbeats import (
    AGAIN_S,
    EACH,
    HEARTBEAT_ID,
    MOST,
    MOST_SENDERS,
    WRITE_S,
    ReceivedHeartbeats,
)
from phm.testing import FakeClock


class Bench:
    def __init__(self) -> None:
        self.clock, self.listeners = FakeClock(), list[Any]()
        listen = SimpleNamespace(listen=lambda callback, ids: self.listeners.append((callback, tuple(ids))))
        self.received = ReceivedHeartbeats(cast(MavlinkSender, listen), self.clock)

    def receive(self, number: int, system: int = 255, component: int = 190, link: str = "ground") -> None:
        ((callback, _),) = self.listeners
        callback(
            SimpleNamespace(get_srcSystem=lambda: system, get_srcComponent=lambda: component, get_seq=lambda: number),
            link,
        )

    def take(self, after_s: float = WRITE_S) -> list[tuple[int, int, int, float]]:
        self.clock.advance(after_s)
        return self.received.take()


def test_every_agent_logs_the_same_frames() -> None:
    """Those with a multiple of 8 as their number, with the time of their reception."""
    bench = Bench()
    assert bench.listeners[0][1] == (HEARTBEAT_ID,)
    start_s = bench.clock.mono()
    for number in range(3 * EACH):
        bench.receive(number)
        bench.clock.advance(0.1)
    assert [(frame[:3], round(frame[3] - start_s, 3)) for frame in bench.take()] == [
        ((255, 190, 0), 0.0),
        ((255, 190, 8), 0.8),
        ((255, 190, 16), 1.6),
    ]


def test_a_line_is_written_seldom_and_only_with_frames() -> None:
    """At most one every 10 s."""
    bench = Bench()
    bench.receive(0)
    assert bench.take(WRITE_S - 1) == [] and len(bench.take(1.0)) == 1
    assert bench.take() == []


def test_the_first_reception_of_a_frame_counts() -> None:
    """It may arrive again by another link; 256 frames later the number is that of another one."""
    bench = Bench()
    bench.receive(8)
    bench.clock.advance(AGAIN_S - 1)
    bench.receive(8, link="peers")
    bench.clock.advance(300.0)
    bench.receive(8)
    assert len(bench.take()) == 2


def test_forged_senders_fill_neither_memory_nor_the_log() -> None:
    """Anybody on a link without signing can send as anybody."""
    bench = Bench()
    for system in range(256):
        for component in range(8):
            bench.receive(0, system, component)
    assert len(bench.received._newest) == MOST_SENDERS and len(bench.take()) == MOST


def test_a_new_sender_takes_the_place_of_the_one_that_was_silent_longest() -> None:
    """Also long after senders that were received only once."""
    bench = Bench()
    for system in range(MOST_SENDERS):
        bench.receive(0, system)
        bench.clock.advance(0.01)
    bench.receive(EACH, 0)  # the first of them is received again
    bench.take()
    bench.receive(0, 7, 193)
    assert [frame[:3] for frame in bench.take()] == [(7, 193, 0)]
    assert (0, 190) in bench.received._newest and (1, 190) not in bench.received._newest


def test_without_links_nothing_is_received() -> None:
    """An agent without MAVLink."""
    clock = FakeClock()
    received = ReceivedHeartbeats(None, clock)
    clock.advance(WRITE_S)
    assert received.take() == []


def test_after_a_flood_new_senders_are_logged() -> None:
    """They take the places of those that were silent for the longest time."""
    bench = Bench()
    bench.receive(0, 7, 193)
    for component in range(MOST_SENDERS):
        bench.receive(0, 250, component)
    bench.clock.advance(AGAIN_S)
    bench.take()
    bench.receive(EACH, 8, 193)
    assert [frame[:3] for frame in bench.take()] == [(8, 193, EACH)]
