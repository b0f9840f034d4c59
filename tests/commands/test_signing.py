"""Signing: which frames are accepted, that an attacker can do nothing, and what survives a restart of PHM."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import threading
from pathlib import Path
from typing import Any, cast

import pytest
from hypothesis import given, strategies as st

from phm.testing import FakeClock
from phm.transport import mavlink_signing
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_signing import (
    KEPT_STREAMS,
    LAST,
    MAX_STREAMS,
    NAME,
    SAVE_S,
    TICKS,
    WARNED_S,
    InvalidKey,
    SignatureResult,
    Signer,
    Signing,
    read_key,
    unsigned_of,
)
from tests.fakes.mavlink import Sender, heartbeat, text
from tests.fakes.until import until

KEY, OTHER = bytes(range(32)), bytes(32)
NOW = 1_420_070_400 + 10 * 365 * 86400
"""Ten years after the epoch of signing."""


def at(utc: float = NOW) -> FakeClock:
    return FakeClock(utc=utc)


def ticks(utc: float) -> int:
    return round((utc - 1_420_070_400) * TICKS)


def sign(frame: bytes, time: int, *, key: bytes = KEY, link: int = 5) -> bytes:
    """An unsigned MAVLink 2 frame, signed with this key; written from the standard and independent of our code."""
    length = frame[1]
    head = bytes((frame[0], length, 1, *frame[3:10]))
    payload = frame[10 : 10 + length]
    number = int.from_bytes(frame[7:10], "little")
    crc = mavlink.x25crc(bytearray((*head[1:], *payload, mavlink.mavlink_map[number].crc_extra))).crc
    body = head + payload + struct.pack("<HB", crc, link) + time.to_bytes(6, "little")
    return body + hashlib.sha256(key + body).digest()[:6]


def heartbeat_frame(time: int, *, key: bytes = KEY, link: int = 5, sender: tuple[int, int] = (255, 190)) -> bytes:
    return sign(Sender(*sender).frame(heartbeat()), time, key=key, link=link)


# ---------------------------------------------------------------- the key


@pytest.mark.parametrize("data", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_a_key_is_32_bytes_or_their_hexadecimal_digits(tmp_path: Path, data: bytes) -> None:
    """In a file that only its owner can read."""
    path = tmp_path / "key"
    path.write_bytes(data)
    path.chmod(0o600)
    assert read_key(str(path)) == KEY


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o644, 0o610, 0o660, 0o666])
def test_a_key_that_others_can_read_is_rejected(tmp_path: Path, mode: int) -> None:
    """The error says what to do."""
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(mode)
    with pytest.raises(InvalidKey, match=r"others than its owner .*chmod 600"):
        read_key(str(path))


@pytest.mark.parametrize("data", [b"", b"x" * 31, b"x" * 33, b"0" * 63, b"g" * 64, b"\xff" * 64, b"0" * 5000])
def test_an_invalid_key_is_rejected(tmp_path: Path, data: bytes) -> None:
    """The content is never shown."""
    path = tmp_path / "key"
    path.write_bytes(data)
    path.chmod(0o600)
    with pytest.raises(InvalidKey, match=r"must hold 32 bytes or 64 hexadecimal digits"):
        read_key(str(path))


def test_an_unreadable_key_is_reported(tmp_path: Path) -> None:
    """Missing, a directory, a pipe without a writer."""
    os.mkfifo(tmp_path / "pipe", 0o600)
    for name in ("absent", ".", "pipe"):
        with pytest.raises(InvalidKey, match=r"^mavlink\.signing\.key"):
            read_key(str(tmp_path / name))


# ---------------------------------------------------------------- incoming frames


def test_a_signed_frame_is_accepted_once() -> None:
    """An identical or older frame is old; a newer one is accepted."""
    signing, now = Signing(KEY, at()), ticks(NOW)
    assert signing.check(heartbeat_frame(now)) is SignatureResult.GOOD
    assert signing.check(heartbeat_frame(now)) is SignatureResult.OLD
    assert signing.check(heartbeat_frame(now - 1)) is SignatureResult.OLD
    assert signing.check(heartbeat_frame(now + 1)) is SignatureResult.GOOD


def test_a_forged_time_changes_nothing() -> None:
    """A frame from the far future with a wrong hash affects neither the real sender nor our own time."""
    signing, now = Signing(KEY, at()), ticks(NOW)
    assert signing.check(heartbeat_frame(now)) is SignatureResult.GOOD
    before = (dict(signing._streams), signing._time)
    forged = bytearray(heartbeat_frame(now + 1))
    forged[-12:-6] = (LAST - 1).to_bytes(6, "little")
    assert signing.check(forged) is SignatureResult.FORGED
    assert signing.check(heartbeat_frame(LAST - 1, key=OTHER)) is SignatureResult.FORGED
    assert (signing._streams, signing._time) == before
    assert signing.check(heartbeat_frame(now + 1)) is SignatureResult.GOOD
    assert "wrong signature" in signing.problem()


def test_pymavlink_itself_accepts_a_forged_time() -> None:
    """This is why PHM has its own check: when this test fails, pymavlink has been fixed."""
    theirs = mavlink.MAVLink(None)
    theirs.signing.secret_key = KEY
    with pytest.raises(mavlink.MAVError):
        theirs.decode(bytearray(heartbeat_frame(LAST - 1, key=OTHER)))
    with pytest.raises(mavlink.MAVError):
        theirs.decode(bytearray(heartbeat_frame(ticks(NOW))))


@given(st.integers(0, 8 * 46 - 1))
def test_every_bit_of_a_frame_is_covered(bit: int) -> None:
    """With any bit inverted, the frame is rejected and leaves no trace."""
    frame = bytearray(heartbeat_frame(ticks(NOW)))
    bit %= 8 * len(frame)
    frame[bit // 8] ^= 1 << bit % 8
    signing = Signing(KEY, at())
    assert signing.check(frame) is not SignatureResult.GOOD
    assert (signing._streams, signing._time) == ({}, 0)


def test_a_new_sender_may_be_a_minute_late_and_no_more() -> None:
    """A frame recorded yesterday from a sender not received since is rejected."""
    signing, now = Signing(KEY, at()), ticks(NOW)
    assert signing.check(heartbeat_frame(now - 59 * TICKS, link=1)) is SignatureResult.GOOD
    assert signing.check(heartbeat_frame(now - 61 * TICKS, link=2)) is SignatureResult.OLD
    assert signing.check(heartbeat_frame(now - 61 * TICKS, sender=(254, 190))) is SignatureResult.OLD


def test_a_companion_without_a_clock_takes_the_time_of_the_ground() -> None:
    """It starts in 1970, accepts its operator, and signs with a time that the operator accepts."""
    signing, now = Signing(KEY, at(0.0)), ticks(NOW)
    assert signing.check(heartbeat_frame(now)) is SignatureResult.GOOD
    assert signing.stamp() == now + 1


def test_the_end_of_time_is_rejected() -> None:
    """Our own time would follow and could not advance: 48 bits."""
    signing = Signing(KEY, at())
    assert signing.check(heartbeat_frame(LAST + 1)) is SignatureResult.OLD
    assert signing.check(heartbeat_frame(2**48 - 1)) is SignatureResult.OLD
    assert signing.stamp() == ticks(NOW)


def test_senders_are_bounded() -> None:
    """The sender received longest ago is forgotten; its old frames are rejected after a minute."""
    clock = at()
    signing = Signing(KEY, clock)
    first = heartbeat_frame(ticks(NOW), link=0, sender=(1, 1))
    assert signing.check(first) is SignatureResult.GOOD
    clock.advance(120.0)
    for n in range(MAX_STREAMS):
        assert (
            signing.check(heartbeat_frame(ticks(NOW + 120) + n, link=n % 256, sender=(2 + n // 256, 1)))
            is SignatureResult.GOOD
        )
    assert len(signing._streams) == MAX_STREAMS
    assert signing.check(first) is SignatureResult.OLD


# ---------------------------------------------------------------- outgoing frames


def test_times_only_rise() -> None:
    """Whatever the clock does."""
    clock = at()
    signing, given_out = Signing(KEY, clock), []
    for step in (0.0, 0.0, 5.0, -100.0, 0.0, 3.0, 200.0):
        clock.jump_utc(step)
        given_out.append(signing.stamp())
    assert given_out == sorted(set(given_out))
    assert given_out[-1] == ticks(clock.utc())


def test_a_sender_with_a_long_uptime_is_accepted_by_a_new_receiver() -> None:
    """The time is refreshed before each frame; pymavlink's own receiver decides."""
    clock = at()
    codec = Codec(7, 193, lambda number: True, Signer(Signing(KEY, clock), 3, unsigned_of("vehicle")))
    codec.pack(heartbeat())
    clock.advance(3600.0)
    receiver = mavlink.MAVLink(None)
    receiver.signing.secret_key, receiver.signing.timestamp = KEY, ticks(clock.utc())
    message = receiver.decode(bytearray(codec.pack(heartbeat())))
    assert message.get_signed()
    assert message.get_link_id() == 3


@pytest.mark.parametrize(
    "message", [heartbeat(), text("A07 OK 11111111"), mavlink.MAVLink_tunnel_message(0, 0, 46193, 1, [1, *[0] * 127])]
)
def test_a_signature_is_13_bytes_and_the_budget_counts_them(message: Any) -> None:
    """`size` equals the length of `pack`."""
    plain = Codec(7, 193, lambda number: True)
    signed = Codec(7, 193, lambda number: True, Signer(Signing(KEY, at()), 0, unsigned_of("vehicle")))
    assert plain.size(message) == len(plain.pack(message))
    assert signed.size(message) == len(signed.pack(message)) == plain.size(message) + 13


# ---------------------------------------------------------------- through the parser

COMMAND = mavlink.MAVLink_command_long_message(7, 193, 31010, 0, 1, 0, 0, 0, 0, 0, 0)
RADIO = mavlink.MAVLink_radio_status_message(1, 1, 100, 1, 1, 0, 0)
TUNNEL = mavlink.MAVLink_tunnel_message(0, 0, 46193, 1, [1, *[0] * 127])


def parse(mode: str, *frames: bytes) -> tuple[list[tuple[str, bool]], dict[str, int]]:
    """Types of the forwarded messages with their signed flag, and the counts of rejected ones."""
    codec = Codec(7, 193, lambda number: True, Signer(Signing(KEY, at()), 0, unsigned_of(mode)))
    parser = codec.parser()
    messages = [message for frame in frames for message in parser.feed(frame)]
    assert not parser._buffer
    return [(message.get_type(), message.get_signed()) for message in messages], codec.refused()


@pytest.mark.parametrize(
    ("mode", "passed"),
    [
        ("vehicle", ["HEARTBEAT", "RADIO_STATUS", "COMMAND_LONG"]),
        ("all", ["HEARTBEAT", "RADIO_STATUS", "TUNNEL", "COMMAND_LONG"]),
        ("none", ["RADIO_STATUS", "COMMAND_LONG"]),
    ],
)
def test_messages_accepted_without_a_signature_depend_on_the_mode(mode: str, passed: list[str]) -> None:
    """Commands are forwarded as unsigned, so that they are refused with an answer."""
    sender = Sender(255, 190)
    types, refused = parse(mode, *(sender.frame(each) for each in (heartbeat(), RADIO, TUNNEL, COMMAND)))
    assert types == [(name, False) for name in passed]
    assert refused["unsigned"] == 4 - len(passed)


@pytest.mark.parametrize("mode", ["vehicle", "all", "none"])
def test_a_signed_message_is_forwarded_as_such_and_a_copy_of_a_command_is_not(mode: str) -> None:
    """A copy of a message that is also accepted unsigned is forwarded as unsigned."""
    sender, now = Sender(255, 190), ticks(NOW)
    signed = [sign(sender.frame(each), now + n) for n, each in enumerate((heartbeat(), TUNNEL, COMMAND))]
    types, refused = parse(mode, *signed, *signed)
    copies = {"vehicle": ["HEARTBEAT"], "all": ["HEARTBEAT", "TUNNEL"], "none": []}[mode]
    assert types == [(n, True) for n in ("HEARTBEAT", "TUNNEL", "COMMAND_LONG")] + [(n, False) for n in copies]
    assert refused["old"] == 3 - len(copies)


@pytest.mark.parametrize("mode", ["vehicle", "all", "none"])
def test_a_message_signed_with_another_key_is_never_forwarded(mode: str) -> None:
    """Not as unsigned, either."""
    sender = Sender(255, 190)
    forged = [sign(sender.frame(each), ticks(NOW), key=OTHER) for each in (heartbeat(), RADIO, TUNNEL, COMMAND)]
    assert parse(mode, *forged) == ([], {"forged": 4, "old": 0, "unsigned": 0})


# ---------------------------------------------------------------- across a restart


def test_a_recorded_command_is_rejected_after_a_restart(tmp_path: Path) -> None:
    """Senders are saved; also by a PHM that was killed, if it was saved before the command was executed."""
    first = Signing(KEY, at(), str(tmp_path))
    recorded = heartbeat_frame(ticks(NOW))
    assert first.check(recorded) is SignatureResult.GOOD
    first.save()
    assert Signing(KEY, at(NOW + 5), str(tmp_path)).check(recorded) is SignatureResult.OLD
    assert Signing(KEY, at(NOW + 5)).check(recorded) is SignatureResult.GOOD


def test_a_companion_without_a_clock_continues_with_its_saved_time(tmp_path: Path) -> None:
    """Times that may have been used between the last save and the end are skipped."""
    first = Signing(KEY, at(0.0), str(tmp_path))
    assert first.check(heartbeat_frame(ticks(NOW))) is SignatureResult.GOOD
    first.save()
    assert Signing(KEY, at(0.0), str(tmp_path)).stamp() == ticks(NOW) + SAVE_S * TICKS + 1


def test_orderly_restarts_of_a_companion_without_a_clock_do_not_run_ahead(tmp_path: Path) -> None:
    """All times that were used are saved then. All agents follow the newest time, and refuse commands while it is ahead of theirs."""
    first = Signing(KEY, at(0.0), str(tmp_path))
    assert first.check(heartbeat_frame(ticks(NOW))) is SignatureResult.GOOD
    first.close()
    for n in range(100):
        signing = Signing(KEY, at(0.0), str(tmp_path))
        assert signing.stamp() == ticks(NOW) + n + 1
        signing.close()


@pytest.mark.parametrize("ends", ["killed", "an endpoint still sends"])
def test_a_time_is_not_used_twice_after_an_end_that_was_not_orderly(tmp_path: Path, ends: str) -> None:
    """A start marks the file, and so does an end at which a thread hangs that may sign more."""
    first = Signing(KEY, at(0.0), str(tmp_path))
    assert first.check(heartbeat_frame(ticks(NOW))) is SignatureResult.GOOD
    first.close()
    second = Signing(KEY, at(0.0), str(tmp_path))
    second.start()
    if ends == "killed":
        second._stop.set()
    else:
        second.close(ended=False)
    assert Signing(KEY, at(0.0), str(tmp_path)).stamp() == ticks(NOW) + SAVE_S * TICKS + 1


def test_a_slower_save_does_not_replace_a_newer_one(tmp_path: Path) -> None:
    """Two threads save, and one of them loses its CPU: what was recorded before a command is executed stays recorded."""
    signing = Signing(KEY, at(), str(tmp_path))
    began, go, lock = threading.Event(), threading.Event(), signing._file

    class Slow:
        """The lock of the file, which the slower thread gets last."""

        def __enter__(self) -> None:
            if threading.current_thread() is slower:
                began.set()
                go.wait(60)
            lock.acquire()

        def __exit__(self, *_: object) -> None:
            lock.release()

    signing._file = cast(Any, Slow())
    slower = threading.Thread(target=signing.save)
    slower.start()
    assert began.wait(60)
    recorded = heartbeat_frame(ticks(NOW) + 1)
    assert signing.check(recorded) is SignatureResult.GOOD
    signing.save()
    go.set()
    slower.join(60)
    assert Signing(KEY, at(NOW + 5), str(tmp_path)).check(recorded) is SignatureResult.OLD


def test_a_disk_that_hangs_delays_start_and_commands_for_a_limited_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next request is refused immediately. When the disk answers again, the newest state is stored."""
    released, write = threading.Event(), mavlink_signing._write

    def hang(path: Path, data: bytes) -> None:
        released.wait()
        write(path, data)

    monkeypatch.setattr(mavlink_signing, "_write", hang)
    monkeypatch.setattr(mavlink_signing, "DISK_S", 0.1)
    signing = Signing(KEY, at(), str(tmp_path))
    signing.start()
    recorded = heartbeat_frame(ticks(NOW) + 1)
    assert signing.check(recorded) is SignatureResult.GOOD
    monkeypatch.setattr(mavlink_signing, "DISK_S", threading.TIMEOUT_MAX)
    with pytest.raises(TimeoutError, match="does not answer"):
        signing.save_in_time()
    released.set()
    until(lambda: signing._done == signing._requested, "the answers")
    assert signing.save_in_time() == ""
    assert Signing(KEY, at(NOW + 5), str(tmp_path)).check(recorded) is SignatureResult.OLD
    signing.close()


def test_consecutive_restarts_do_not_run_ahead_of_a_good_clock(tmp_path: Path) -> None:
    """A hundred restarts, a second apart."""
    for n in range(100):
        signing = Signing(KEY, at(NOW + n), str(tmp_path))
        assert signing.stamp() == ticks(NOW + n)
        signing.save()


@pytest.mark.parametrize(
    "damage",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b'{"v": 1}',
        b'{"time": -1, "streams": []}',
        b'{"time": 1e3, "streams": []}',
        b'{"time": true, "streams": []}',
        b'{"time": 5, "streams": [[1, 2, 3]]}',
        b'{"time": 5, "streams": [[1, 2, 999, 4]]}',
        b'{"time": 5, "streams": 7}',
        b"[" * 60_000,
        b"x" * 100_000,
        b"\xff\xfe",
        json.dumps({"time": 2**48, "streams": []}).encode(),
    ],
)
def test_a_damaged_file_is_reported_and_the_clock_counts(tmp_path: Path, damage: bytes) -> None:
    """The start replaces it, and `companion` still names it: no check has run before."""
    (tmp_path / NAME).write_bytes(damage)
    clock = at()
    signing = Signing(KEY, clock, str(tmp_path))
    assert signing.stamp() == ticks(NOW)
    signing.start()
    assert "damaged" in signing.problem()
    clock.advance(WARNED_S)
    assert signing.problem() == ""
    signing.close()
    assert Signing(KEY, at(), str(tmp_path)).problem() == ""


def test_a_directory_without_write_access_is_reported(tmp_path: Path) -> None:
    """Signing continues."""
    (tmp_path / "file").write_text("")
    signing = Signing(KEY, at(), str(tmp_path / "file"))
    signing.save()
    assert "could be replayed" in signing.problem() or "cannot" in signing.problem()
    assert signing.stamp() == ticks(NOW)


def test_the_file_is_small_and_private(tmp_path: Path) -> None:
    """And does not contain the key."""
    signing = Signing(KEY, at(), str(tmp_path))
    for n in range(MAX_STREAMS):
        signing.check(heartbeat_frame(ticks(NOW) + n, link=n % 256, sender=(1 + n // 256, 1)))
    signing.save()
    file = tmp_path / NAME
    assert len(json.loads(file.read_bytes())["streams"]) == KEPT_STREAMS
    assert file.stat().st_mode & 0o777 == 0o600
    assert file.stat().st_size < 20_000
    assert KEY.hex().encode() not in file.read_bytes()
