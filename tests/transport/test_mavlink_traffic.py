"""Senders of MAVLink frames and the gaps in their sequence numbers."""

from __future__ import annotations

from collections.abc import Iterable

from hypothesis import given, strategies as st

from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_traffic import MAX_SENDERS, SenderTable
from tests.fakes.mavlink import Sender, heartbeat


def counted(sequences: Iterable[int]) -> tuple[int, int]:
    """Frames and lost frames of one sender."""
    senders = SenderTable()
    for number in sequences:
        senders.receive(1, 1, number % 256)
    return senders.now().get((1, 1), (0, 0))


@given(st.integers(0, 255), st.lists(st.integers(0, 60), max_size=300))
def test_skipped_sequence_numbers_are_lost_frames(start: int, gaps: list[int]) -> None:
    """Each gap counts in full, also across the wrap-around of the number."""
    sequences, at = [start], start
    for gap in gaps:
        at += gap + 1
        sequences.append(at)
    assert counted(sequences) == (len(sequences), sum(gaps))


def test_duplicate_and_reordered_frames_are_not_lost() -> None:
    """By two routes, or in another order: a received frame is not missing."""
    assert counted([1, 1, 2, 2, 3]) == (3, 0)
    assert counted([1, 3, 2, 4]) == (4, 0)
    assert counted([254, 0, 255, 1]) == (4, 0)


def test_a_restarted_sender_has_lost_nothing() -> None:
    """After a reboot, or a pause, the number may have any value."""
    assert counted([10, 11, 140, 141])[1] == 0
    assert counted([200, 201, 70, 71])[1] == 0


def test_senders_are_limited() -> None:
    """Forged senders do not displace a real one."""
    senders = SenderTable()
    for number in range(100):
        senders.receive(1, 1, number)
    for made_up in range(1000):
        senders.receive(2 + made_up // 250, made_up % 250, 0)
    assert len(senders.now()) == MAX_SENDERS
    assert senders.now()[1, 1] == (100, 0)


def test_ignored_frames_count_as_well() -> None:
    """Loss is measured with all frames, though most are never decoded. Each of those counts when the next one begins."""
    codec = Codec(7, 193, lambda number: False)
    sender, reader = Sender(7, 1), codec.parser()
    frames = [sender.frame(heartbeat(n), v1=n % 2 == 0) for n in range(11)]
    for frame in frames[:3] + frames[5:]:
        assert reader.feed(frame) == []
    assert codec.senders.now() == {(7, 1): (8, 2)}


def test_the_old_message_id_of_radio_status_is_accepted() -> None:
    """Radios with old firmware send RADIO, id 166, which is treated as RADIO_STATUS."""
    radio = mavlink.mavlink_map[166](180, 170, 90, 40, 45, 3, 4)
    radio._header.msgId = 166
    frame = Sender(51, 68).frame(radio, v1=True)
    assert frame[5] == 166
    codec = Codec(7, 193, lambda number: number == mavlink.MAVLINK_MSG_ID_RADIO_STATUS)
    (message,) = codec.parser().feed(frame)
    assert message.get_msgId() == mavlink.MAVLINK_MSG_ID_RADIO_STATUS
    assert (message.rssi, message.remrssi, message.txbuf, message.rxerrors, message.fixed) == (180, 170, 90, 3, 4)
