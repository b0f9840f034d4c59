"""Bytes from outside: valid frames are found in any input, and nothing raises or grows."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import FALSE_FRAMES, Codec, Parser
from tests.fakes.mavlink import Sender, heartbeat, text

FRAME = Sender(7, 1).frame(heartbeat(5))
TEXT = Sender(7, 1).frame(text("A07 OK 11111111"))


def parser(*ids: int) -> Parser:
    wanted = frozenset(ids or (0, 253))
    return Codec(1, 193, lambda number: number in wanted).parser()


def names(messages: list[object]) -> list[str]:
    return [message.get_type() for message in messages]  # type: ignore[attr-defined]


def waiting(reader: Parser) -> int:
    return len(reader._buffer)


@given(st.lists(st.binary(max_size=600), max_size=8), st.booleans())
def test_garbage_raises_nothing_and_is_not_kept(chunks: list[bytes], verify: bool) -> None:
    """Any bytes in any pieces leave at most one incomplete frame buffered."""
    reader = parser()
    for chunk in chunks:
        reader.feed(chunk, verify=verify)
        assert waiting(reader) <= 280


@given(st.binary(max_size=400).filter(lambda data: not {0xFD, 0xFE} & set(data)), st.integers(1, 40))
def test_a_frame_behind_noise_is_found(noise: bytes, size: int) -> None:
    """Noise before, between and after frames loses no frame, whatever the size of the pieces."""
    stream = noise + FRAME + noise + TEXT + noise
    reader = parser()
    found = [message for at in range(0, len(stream), size) for message in reader.feed(stream[at : at + size])]
    assert names(found) == ["HEARTBEAT", "STATUSTEXT"]


@given(st.integers(1, len(FRAME) - 1), st.integers(1, 255))
def test_a_damaged_frame_is_dropped_and_the_next_one_is_found(at: int, flip: int) -> None:
    """No changed byte passes the checksum, and at most the damaged frame is lost."""
    damaged = bytearray(FRAME)
    damaged[at] ^= flip
    # A damaged length may claim up to 280 bytes before the checksum fails.
    stream = bytes(damaged) + FRAME * 16
    found = parser().feed(stream)
    assert 1 <= len(found) <= 16
    assert {message.custom_mode for message in found} == {5}


@given(st.integers(0, len(TEXT) - 1))
def test_a_truncated_datagram_is_forgotten(size: int) -> None:
    """A frame never continues in the next datagram."""
    reader = parser()
    assert reader.datagram(TEXT[:size]) == []
    assert waiting(reader) == 0
    assert names(reader.datagram(FRAME)) == ["HEARTBEAT"]


@settings(max_examples=50)
@given(st.binary(min_size=9, max_size=9), st.integers(0, 255), st.integers(0, 255))
def test_hostile_heartbeats_are_decoded_or_dropped(payload: bytes, system: int, component: int) -> None:
    """A frame with a valid checksum may contain anything; it becomes a message or nothing."""
    sender = Sender(system, component)
    message = heartbeat(int.from_bytes(payload[:4], "little"), kind=payload[4], autopilot=payload[5])
    (found,) = parser().feed(sender.frame(message))
    assert (found.get_srcSystem(), found.get_srcComponent(), found.type) == (system, component, payload[4])


@pytest.mark.parametrize("noise", [b"\xfe", b"\xfe\x4c", b"\xfd\x10\x00", b"\xfe\xfd"])
def test_a_datagram_of_false_starts_costs_few_checksums(noise: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each byte could begin a frame: without a limit four such datagrams a second kept the thread from sending."""
    reader, checked = parser(), []
    monkeypatch.setattr(reader._mav, "decode", lambda frame: checked.append(frame) or _fail())
    data = noise * (65507 // len(noise))
    assert reader.datagram(data, verify=True) == []
    assert len(checked) <= FALSE_FRAMES
    assert waiting(reader) == 0


def _fail() -> None:
    raise ValueError("wrong checksum")


def test_the_frames_of_a_datagram_are_found_behind_a_few_false_starts() -> None:
    """As before in a stream: noise before and between frames loses none."""
    assert names(parser().datagram(b"noise" + FRAME + b"\xfe\x00" + TEXT)) == ["HEARTBEAT", "STATUSTEXT"]


def test_version_1_frames_are_read() -> None:
    """Old radios and autopilots still use MAVLink 1."""
    assert names(parser().feed(Sender(7, 1).frame(heartbeat(), v1=True))) == ["HEARTBEAT"]


def test_unwanted_messages_are_skipped_and_counted() -> None:
    """The autopilot's stream is not decoded; frames behind it are found."""
    reader = parser(0)
    assert names(reader.feed(FRAME + TEXT + FRAME)) == ["HEARTBEAT", "HEARTBEAT"]
    assert reader._counters.received == 3
    assert reader.verified == 2


def test_messages_of_other_dialects_are_skipped_entirely() -> None:
    """A frame of an unknown message loses no other frame, even when its payload looks like a frame."""
    unknown = bytes([0xFD, 30, 0, 0, 1, 7, 1]) + (0x00FFFF).to_bytes(3, "little") + b"\xfe" * 30 + b"\x12\x34"
    reader = parser()
    assert names(reader.feed(unknown + FRAME)) == ["HEARTBEAT"]
    assert reader._counters.bad == 0


def test_frames_with_unknown_flags_are_dropped() -> None:
    """The standard requires it: the flag may change the meaning of the bytes."""
    odd = bytearray(FRAME)
    odd[2] = 0x02
    assert names(parser().feed(bytes(odd) + FRAME)) == ["HEARTBEAT"]


def test_every_codec_has_its_own_sequence_and_changes_no_message() -> None:
    """Receivers count losses by the sequence number; two endpoints may pack the same message at the same time."""
    message = heartbeat(1)
    first, second = Codec(1, 193, lambda _: True), Codec(1, 193, lambda _: True)
    frames = [first.pack(message), first.pack(message), second.pack(message)]
    assert [frame[4] for frame in frames] == [0, 1, 0]
    assert message.get_seq() == 0
    assert first.sent(frames[1])
    assert not second.sent(frames[1])


@pytest.mark.parametrize(("message", "size"), [(heartbeat(0x40025D55), 21), (heartbeat(0), 21), (text("x" * 50), 63)])
def test_frame_sizes_are_the_documented_ones(message: object, size: int) -> None:
    """docs/reference/mavlink.md states them, whatever the status word is."""
    frame = Codec(1, 193, lambda _: True).pack(message)
    assert (len(frame), frame[0]) == (size, 0xFD)
    assert float(mavlink.WIRE_PROTOCOL_VERSION) == 2.0
