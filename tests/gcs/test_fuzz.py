"""Hostile bytes from the parser to the table: nothing raises, nothing grows, and no other row changes."""

from __future__ import annotations

import io
import json
import random

from hypothesis import HealthCheck, given, settings as hypothesis_settings, strategies as st
from rich.console import Console

from phm.gcs import frames, table
from phm.gcs.events import describe_with_time, encode
from phm.gcs.ingress_filter import BURST, MAX_COPIES, NEW_BURST, IngressFilter
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.wire import tunnel
from tests.fakes.mavlink import Sender, heartbeat, text
from tests.gcs.bench import HEALTHY, Ground, phm_heartbeat

HARD = hypothesis_settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
NUMBERS = st.integers(0, 2**32 - 1)
BYTE = st.integers(0, 255)
HEARTBEATS = st.builds(
    lambda kind, autopilot, mode, word, state: mavlink.MAVLink_heartbeat_message(kind, autopilot, mode, word, state, 3),
    st.sampled_from([18, 6, 2, 255]),
    st.sampled_from([8, 3, 255]),
    BYTE,
    NUMBERS | st.sampled_from([0, 1 << 30, 0x40025D55, 0x7FFFFFFF]),
    BYTE,
)
LINES = st.from_regex(
    r"(A[0-9]{2,3}|SWARM) (FAIL|OK|WARN|1/2|no GCS radio, received by A01:) [0-9]{1,9}.{0,20}", fullmatch=True
)
TEXTS = st.builds(
    lambda words, severity: mavlink.MAVLink_statustext_message(severity, words),
    st.binary(max_size=50) | LINES.map(lambda line: line.encode()[:50]),
    BYTE,
)
TUNNELS = st.builds(
    lambda data: mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, len(data), list(data.ljust(128, b"\0"))),
    st.binary(max_size=128)
    | st.builds(lambda kind, rest: bytes((0x10 | kind,)) + rest, st.integers(1, 5), st.binary(max_size=40)),
)
RADIOS = st.builds(lambda *levels: mavlink.MAVLink_radio_status_message(*levels, 1, 1), BYTE, BYTE, BYTE, BYTE, BYTE)
SENDERS = st.tuples(st.sampled_from([0, 7, 8, 51, 250, 251, 255]), st.sampled_from([0, 1, 190, 193, 255]))


class Link:
    """Bytes of a link on their way to the fleet state, processed as in the station."""

    def __init__(self) -> None:
        self.ground = Ground()
        self.parser = Codec(254, 190, frames.IDS.__contains__).parser()

    def feed(self, data: bytes) -> None:
        for message in self.parser.feed(data):
            frame = frames.parse(message)
            assert frame is not None
            for news in self.ground.receive(frame):
                json.loads(encode(news, "run", 1))
                assert describe_with_time(news).isprintable()

    def observe(self) -> None:
        """Every output can be generated."""
        for news in self.ground.wait(1):
            assert describe_with_time(news).isprintable()
        snapshot = {**self.ground.snapshot(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}
        json.dumps(snapshot, allow_nan=False)
        Console(file=io.StringIO(), width=80).print(table.render(snapshot, height=24))
        assert len(snapshot["agents"]) <= 512


@HARD
@given(st.lists(st.tuples(SENDERS, HEARTBEATS | TEXTS | TUNNELS | RADIOS), max_size=30))
def test_any_valid_frame_is_accepted(sent: list[tuple[tuple[int, int], object]]) -> None:
    """Any fields, from any sender."""
    link = Link()
    for (system, component), message in sent:
        link.feed(Sender(system, component).frame(message))
        link.ground.clock.advance(0.5)
    link.observe()


@HARD
@given(st.lists(st.binary(max_size=80) | st.integers(0, 400), max_size=20), st.integers())
def test_garbage_and_damaged_frames_change_nothing(pieces: list[bytes | int], seed: int) -> None:
    """Between valid frames of an agent: its row shows its reports, and no other row appears."""
    link, agent, luck = Link(), Sender(7, 193), random.Random(seed)
    good = heartbeat(0x40025D55)
    for piece in pieces:
        if isinstance(piece, bytes):
            link.feed(bytes(byte for byte in piece if byte not in (0xFD, 0xFE)))
        else:
            frame = bytearray(Sender(8, 193).frame(text("A08 FAIL 6 node_1 dead")))
            frame[luck.randrange(10, len(frame))] ^= 1 << luck.randrange(8)
            link.feed(bytes(frame))
        link.feed(agent.frame(good))
    for _ in range(20):  # the parser waits for an announced length: valid frames follow on a live link
        link.feed(agent.frame(good))
    link.observe()
    assert [one["agent"] for one in link.ground.snapshot()["agents"]] == [7]
    assert link.ground.agent(7)["slots"]["6"] == "ERROR"


def test_other_senders_cannot_change_the_row_of_an_agent() -> None:
    """Frames of all other senders, with lines about this agent: its row does not change."""
    ground, luck = Ground(), random.Random(1)
    ground.receive(phm_heartbeat(7))
    before = {**ground.agent(7), "age_s": None}
    for _ in range(2000):
        system, component = luck.randrange(256), luck.randrange(256)
        if (system, component) == (7, 193):
            continue
        words = luck.choice(
            ["A07 FAIL 6 node_1 dead", "A07 OK 11111111", "A07 FAIL 11111011 6 x", "SWARM 0/9 FAIL A07:lost"]
        )
        ground.receive(frames.StatusText(system, component, 2, words))
    assert {**ground.agent(7), "age_s": None} == before
    assert ground.snapshot()["swarm"] is None
    assert before["slots"] == {str(int(slot)): "OK" for slot in HEALTHY}


# ---------------------------------------------------------------- the ingress filter


def test_a_sender_uses_up_its_own_share() -> None:
    """A burst and a rate; it recovers with time, and the others are unaffected."""
    ingress = IngressFilter()
    taken = sum(ingress.allow((9, 1), 100.0) for _ in range(5000))
    assert taken == BURST
    assert ingress.allow((7, 193), 100.0)
    assert not ingress.allow((9, 1), 100.0)
    assert ingress.allow((9, 1), 100.1)


def test_unsigned_frames_do_not_displace_signed_ones() -> None:
    """Neither under the ids of an agent, nor under many invented ones before an agent is known."""
    ingress = IngressFilter()
    for _ in range(5000):
        ingress.allow((7, 193), 100.0)
    for system in range(20):
        for component in range(200, 250):
            ingress.allow((system, component), 100.0)
    assert not ingress.allow((7, 193), 100.0)
    assert ingress.allow((7, 193), 100.0, signed=True)
    assert ingress.allow((8, 193), 100.0, signed=True)


def test_forged_senders_share_one_limit() -> None:
    """And those that are known already continue."""
    ingress = IngressFilter()
    ingress.allow((7, 193), 100.0)
    taken = sum(ingress.allow((system, component), 100.0) for system in range(20) for component in range(200, 250))
    assert taken == NEW_BURST - 1
    assert ingress.allow((7, 193), 100.0)
    assert ingress.refused == 1000 - taken


def test_copies_by_two_links_count_once() -> None:
    """Equal bytes on the same link do not count as a copy: a sender may not count its frames."""
    ingress = IngressFilter()
    assert not ingress.is_copy(b"frame", "a", 1.0)
    assert ingress.is_copy(b"frame", "b", 1.1)
    assert not ingress.is_copy(b"frame", "a", 1.2)
    assert not ingress.is_copy(b"frame", "b", 20.0)
    for number in range(5000):
        ingress.is_copy(str(number).encode(), "a", 21.0)
    assert len(ingress._frames) <= MAX_COPIES
