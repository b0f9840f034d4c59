"""What is read from a serialized message without its type."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given, strategies as st

from phm.probes.ros.data.raw_message import MAX_DIGESTED, MAX_FRAME, NoHeader, digest, stamp_ns
from tests.fakes.ros_messages import SECOND, stamped


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("stamp", [0, 1, 1_700_000_000 * SECOND + 999_999_999, -5 * SECOND])
def test_the_stamp_is_read_in_both_byte_orders(order: str, stamp: int) -> None:
    """Also a stamp of 0, which was never set, and one before 1970."""
    assert stamp_ns(stamped(stamp, b"data", order=order)) == stamp


def test_an_empty_frame_id_is_a_header() -> None:
    """It is one byte long, its final zero."""
    assert stamp_ns(stamped(7, frame=b"")) == 7


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\0\1",
        stamped(1)[:15],
        b"\0\2" + stamped(1)[2:],
        stamped(1, frame=b"x" * (MAX_FRAME + 1)),
        stamped(1)[:12] + b"\xff\xff\xff\xff" + stamped(1)[16:],
        stamped(1)[:12] + b"\0\0\0\0" + stamped(1)[16:],
        stamped(1)[:8] + b"\xff\xff\xff\xff" + stamped(1)[12:],
        stamped(1, frame=b"abc")[:-1] + b"x",
    ],
)
def test_bytes_that_cannot_be_a_header_are_refused(data: bytes) -> None:
    """Too short, another encoding, a frame_id beyond the message or without its final zero, too many nanoseconds."""
    with pytest.raises(NoHeader):
        stamp_ns(data)


@given(st.binary(max_size=64))
def test_any_bytes_are_a_stamp_or_refused(data: bytes) -> None:
    """Messages come from any participant of the domain."""
    with contextlib.suppress(NoHeader):
        assert isinstance(stamp_ns(data), int)
    digest(data, header=True)


def test_a_new_stamp_is_not_new_content() -> None:
    """A driver that repeats its last frame gives it a current stamp."""
    old, new = stamped(1 * SECOND, b"frame"), stamped(2 * SECOND, b"frame")
    assert digest(old, header=True) == digest(new, header=True) != digest(stamped(1, b"other"), header=True)
    assert digest(old, header=False) != digest(new, header=False)


def test_only_the_ends_of_a_very_long_message_count() -> None:
    """A message of any length takes a few milliseconds."""
    long = bytearray(2 * MAX_DIGESTED + 100)
    before = digest(bytes(long), header=False)
    long[MAX_DIGESTED + 50] = 1
    assert digest(bytes(long), header=False) == before
    long[-1] = 1
    assert digest(bytes(long), header=False) != before
    assert digest(bytes(long[:-1]), header=False) != before
