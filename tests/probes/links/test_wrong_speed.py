"""A serial port that is read at another speed than the autopilot sends at: the bits of its frames, sampled at the wrong times."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator
from typing import Any

import pytest

from phm import api, testing
from phm.facts import LinkFact
from phm.probes.link_stats import RATE_S, LinkStats
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_traffic import Traffic
from phm_checks.link import Link
from tests.fakes.mavlink import Sender, heartbeat, text

PORT = "/dev/ttyUSB0"
WANTED = frozenset((0, 2, 30, 33, 75, 76, 77, 109, 111, 253, 385))
SECONDS = 40


def autopilot(seconds: int) -> list[tuple[float, bytes]]:
    """When an autopilot sends which frame: heartbeats, attitude, position and state."""
    sender, sent = Sender(1, 1), []

    def add(at: float, message: Any) -> None:
        sent.append((at, sender.frame(message)))

    for second in range(seconds):
        add(second, heartbeat(5, kind=mavlink.MAV_TYPE_QUADROTOR, autopilot=3, base_mode=81))
        for step in range(10):
            now = second + step / 10
            swing = [math.sin(now * speed) / 10 for speed in (1.1, 1.3, 1.7, 2.3, 2.9, 3.1)]
            add(now + 0.02, mavlink.MAVLink_attitude_message(int(now * 1000), *swing))
        for step in range(4):
            now = second + step / 4
            drift = int(100 * math.sin(now))
            where = (471234567 + drift, 81234567 - drift, 500000 + drift, 1000 + drift)
            add(
                now + 0.05, mavlink.MAVLink_global_position_int_message(int(now * 1000), *where, drift, -drift, 0, 9000)
            )
            add(now + 0.06, mavlink.MAVLink_vfr_hud_message(1.0, 2.0, 90, 30, 500.0 + drift / 100, drift / 50))
            add(now + 0.07, mavlink.MAVLink_sys_status_message(1, 1, 1, 350, 12000 + drift, 99, 80, 0, 0, 0, 0, 0, 0))
    return sorted(sent, key=lambda one: one[0])


def line(frames: list[tuple[float, bytes]], baud: int) -> tuple[list[float], list[int]]:
    """When the line changes its level, and to which: a start bit, eight bits and a stop bit for each byte."""
    times, levels, now = [-1.0], [1], 0.0
    for at, data in frames:
        now = max(now, at)
        for byte in data:
            for bit in (0, *(byte >> place & 1 for place in range(8)), 1):
                times.append(now)
                levels.append(bit)
                now += 1 / baud
    return times, levels


def received(times: list[float], levels: list[int], baud: int) -> Iterator[tuple[float, int]]:
    """The bytes that a port reads at this speed, and when."""

    def level(at: float) -> int:
        return levels[bisect.bisect_right(times, at) - 1]

    place = 1
    while place < len(times):
        start = times[place]
        if levels[place] == 1 or level(start - 1e-9) == 0:
            place += 1
            continue
        yield start + 10 / baud, sum(level(start + (1.5 + bit) / baud) << bit for bit in range(8))
        place = bisect.bisect_left(times, start + 9.5 / baud)


class Port:
    """A serial endpoint from its bytes to the result of its check."""

    def __init__(self) -> None:
        entries = [{"url": PORT, "name": "fc"}]
        (self._check,) = Link.build(testing.settings(mavlink={"endpoints": entries}))
        self.codec, self._flow = Codec(1, 193, WANTED.__contains__), LinkStats((1, 193))
        self._parser = self.codec.parser()

    def read(self, data: bytes) -> None:
        self._parser.feed(data)

    def condition(self, now: float) -> str:
        """What the check reports."""
        counts = self.codec.counters
        self._flow.sample(
            now,
            Traffic(
                bytes_in=counts.bytes_in,
                frames=counts.received,
                bad=counts.bad,
                senders=self.codec.senders.now(),
                frame_bytes=counts.frame_bytes,
                verified=counts.verified,
            ),
        )
        links = testing.FakeLinks()
        links.endpoints = (self._flow.fact(now, LinkFact("fc", open=True)),)
        result = self._check.run(testing.world(links=links))
        assert isinstance(result, api.Result)
        return result.condition


@pytest.mark.parametrize("piece_s", [0.001, 0.016])
@pytest.mark.parametrize(
    ("sent", "read"), [(57600, 115200), (115200, 57600), (921600, 57600), (57600, 921600), (57600, 38400)]
)
def test_a_wrong_speed_is_reported_all_the_time(sent: int, read: int, piece_s: float) -> None:
    """Some bytes look like frames of messages without a known definition; they are neither a link that is OK nor senders."""
    port, pieces = Port(), dict[int, bytearray]()
    for at, byte in received(*line(autopilot(SECONDS), sent), read):
        pieces.setdefault(int(at / piece_s), bytearray()).append(byte)
    conditions, second = [], 0
    for piece in sorted(pieces):
        while second < piece * piece_s:
            conditions.append(port.condition(float(second)))
            second += 1
        port.read(bytes(pieces[piece]))
    assert len(conditions) > SECONDS - 2
    assert set(conditions[int(RATE_S) :]) == {"link_undecodable"}
    assert port.codec.senders.now() == {}


def test_messages_without_a_known_definition_are_a_valid_link() -> None:
    """Their checksum cannot be computed, but they are all that arrives."""
    port, conditions = Port(), []
    for second in range(SECONDS):
        for step in range(10):
            number, payload = second * 10 + step, bytes(range(30))
            head = bytes([0xFD, len(payload), 0, 0, number % 256, 7, 1]) + (0x00F000).to_bytes(3, "little")
            port.read(head + payload + b"\x12\x34")
        conditions.append(port.condition(float(second)))
    assert set(conditions) == {""}
    assert port.codec.counters.verified == 0


def test_frames_that_are_not_wanted_are_a_valid_link() -> None:
    """A sender is known from its first frame, whatever that is."""
    port, conditions, sender = Port(), [], Sender(7, 158)
    for second in range(SECONDS):
        for step in range(10):
            port.read(sender.frame(mavlink.MAVLink_vfr_hud_message(1.0, 2.0, 90, 30, 500.0, step)))
        conditions.append(port.condition(float(second)))
    assert set(conditions) == {""}
    assert list(port.codec.senders.now()) == [(7, 158)]


def test_a_noisy_link_with_valid_frames_is_not_undecodable() -> None:
    """Most of its bytes are damaged, but its heartbeats arrive: its speed is right."""
    port, conditions, sender = Port(), [], Sender(1, 1)
    for second in range(SECONDS):
        port.read(sender.frame(heartbeat()) + b"\xfe\x55" * 100 + sender.frame(text("x")))
        conditions.append(port.condition(float(second)))
    assert "link_undecodable" not in conditions
