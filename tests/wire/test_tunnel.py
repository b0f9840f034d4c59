"""Tunnel payloads: the layout is a contract, and no input from outside breaks the reader."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.core.model import Level
from phm.wire.tunnel import (
    MAX_BYTES,
    MAX_PARTS,
    MAX_WORDS,
    FaultDetail,
    PeerState,
    PeerView,
    StatusWords,
    SwarmDigest,
    TunnelError,
    TunnelMessage,
    decode,
    details,
    encode,
)

agents = st.integers(1, 250)
seen = st.sampled_from([PeerState.ALIVE, PeerState.LATE, PeerState.LOST])
levels = st.sampled_from([Level.OK, Level.WARN, Level.ERROR])
views = st.builds(
    PeerView, st.integers(0, 255), st.booleans(), st.booleans(), st.booleans(), st.dictionaries(agents, seen)
)
digests = st.integers(0, 250).flatmap(
    lambda members: st.builds(SwarmDigest, st.just(members), st.integers(0, members), st.dictionaries(agents, levels))
)


@given(st.one_of(views, digests))
def test_a_message_is_read_as_written(message: TunnelMessage) -> None:
    """Also when MAVLink has removed trailing zero bytes."""
    payload = encode(message)
    assert decode(payload) == message
    assert decode(payload.rstrip(b"\0")) == message


@given(st.integers(1, 250 - MAX_WORDS), st.lists(st.integers(1, 2**32 - 1), min_size=1, max_size=MAX_WORDS))
def test_words_are_read_as_written(first: int, words: list[int]) -> None:
    """Encoding and decoding give the same words, also if MAVLink cut trailing zeros."""
    message = StatusWords(dict(enumerate(words, first)))
    assert decode(encode(message)) == message
    assert decode(encode(message).rstrip(b"\0")) == message


def test_the_layout_is_the_documented_one() -> None:
    """Bytes written by hand from the module's docstring."""
    assert encode(PeerView(7, True, False, True, {2: PeerState.ALIVE, 4: PeerState.LOST})) == bytes(
        (0x11, 7, 0b101, 2, 0b110001)
    )
    assert encode(SwarmDigest(8, 7, {1: Level.OK, 3: Level.ERROR})) == bytes((0x12, 8, 7, 1, 0b110001))
    assert encode(StatusWords({3: 0x40025D55})) == bytes((0x13, 3, 0x55, 0x5D, 0x02, 0x40))
    assert encode(FaultDetail("ab-1", 0, 1, b"text")) == bytes((0x14, 0, 1, 4)) + b"ab-1text"


def test_a_hundred_agents_fit_into_one_digest() -> None:
    """25 bytes of levels and four of header: 46 bytes on the wire with TUNNEL's own 17."""
    assert len(encode(SwarmDigest(100, 100, dict.fromkeys(range(1, 101), Level.OK)))) == 29


@given(st.binary(max_size=140))
def test_arbitrary_bytes_are_parsed_or_rejected(payload: bytes) -> None:
    """Either a message or TunnelError; a parsed message can be written again."""
    try:
        message = decode(payload)
    except TunnelError:
        return
    if not isinstance(message, FaultDetail):
        assert decode(encode(message)) == message


@pytest.mark.parametrize(
    "payload", [b"", bytes(1), b"\x21", b"\x1f", bytes((0x12, 3, 4)), bytes((0x11, 0, 0, 251)), bytes(129)]
)
def test_a_payload_that_violates_the_contract_is_rejected(payload: bytes) -> None:
    """Too short, too long, of an unknown kind, or with an impossible number."""
    with pytest.raises(TunnelError):
        decode(payload)


@pytest.mark.parametrize(
    "message",
    [
        PeerView(0, True, True, True, {0: PeerState.ALIVE}),
        SwarmDigest(1, 1, {251: Level.OK}),
        StatusWords({1: 5, 200: 5}),
        SwarmDigest(256, 1),
    ],
)
def test_values_out_of_range_are_not_encoded(message: TunnelMessage) -> None:
    """ValueError, so that no agent sends what others must reject."""
    with pytest.raises(ValueError):
        encode(message)


@given(st.text(max_size=4000))
def test_a_long_text_is_sent_in_parts(text: str) -> None:
    """Joined in order they are the text, cut at the end when it is longer than all parts."""
    parts = details("1a2b-17", text)
    assert len(parts) <= MAX_PARTS
    assert all(len(encode(part)) <= MAX_BYTES for part in parts)
    joined = b"".join(decode(encode(part)).text for part in parts)  # type: ignore[union-attr]
    assert text.encode().startswith(joined)
    assert len(parts) == MAX_PARTS or joined == text.encode()
