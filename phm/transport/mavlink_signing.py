"""MAVLink 2 signing: one key for all endpoints, a time that never decreases, and the newest time of each sender.

pymavlink signs outgoing frames. Incoming frames are verified here, because pymavlink adopts the time of a frame before
it compares the hash: one forged frame from the year 2100 would lock out the real sender. Here the hash is compared
first, and an invalid frame changes nothing.

A frame whose time is ahead of ours is accepted, as the standard requires, and our time follows: a companion without a
battery-backed clock starts in the past, and would otherwise reject its operator. Such a frame is signed with the key,
but may have been recorded long ago. So changing commands wait until the clock is set (`MavlinkHub.clock_problem`).
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import os
import stat
import sys
import threading
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any

from phm.core import threads
from phm.core.clock import Clock

SIGNATURE_BYTES = 13
KEY_BYTES = 32
EPOCH_S = 1_420_070_400
"""2015-01-01, the epoch of the standard."""
TICKS = 100_000
"""One second: the unit is 10 microseconds."""
LATE_S = 60.0
"""A new sender may be this far behind our time."""
LAST = 2**48 - 10 * 365 * 86400 * TICKS
"""Later times, from about the year 2094, are rejected: our own time follows and must never exceed its 48 bits."""
MAX_STREAMS = 1024
KEPT_STREAMS = 256
SAVE_S = 30.0
DISK_S = 2.0
"""Longest wait for the disk before a command is executed, and at the start."""
NAME = "mavlink_signing.json"
MAX_FILE_BYTES = 65_536
FORGED_SHOWN_S = 60.0
WARNED_S = 12.0
"""A file of times that cannot be used is reported for this long after the start: the next save replaces it. One refresh of the
status, every 10 s, contains it."""

_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


class InvalidKey(Exception):
    """The key cannot be used; one sentence that says why and what to do."""


class SignatureResult(Enum):
    """Result of verifying the signature of a frame."""

    NONE = "none"
    GOOD = "good"
    OLD = "old"
    """Valid, but not newer than the last frame: a copy or a replay."""
    FORGED = "forged"


def read_key(path: str, setting: str = "mavlink.signing.key") -> bytes:
    """The key: 32 bytes, or 64 hexadecimal digits. setting: what names the file, for messages. Raises InvalidKey."""
    try:
        with open(os.open(path, _READING), "rb") as stream:
            about = os.fstat(stream.fileno())
            if not stat.S_ISREG(about.st_mode):
                raise InvalidKey(f"{setting}: {path} is not a regular file")
            if sys.platform != "win32" and about.st_mode & 0o077:  # Windows has no such bits
                raise InvalidKey(
                    f"{setting}: {path} can be read by others than its owner (mode "
                    f"{stat.S_IMODE(about.st_mode):04o}): `chmod 600 {path}`, and make a new key if it was read"
                )
            data = stream.read(4096)
    except OSError as error:
        raise InvalidKey(f"{setting}: {path} cannot be read: {error.strerror or error}") from error
    if len(data) == KEY_BYTES:
        return data
    with contextlib.suppress(ValueError):
        words = bytes.fromhex(data.decode("ascii").strip())
        if len(words) == KEY_BYTES:
            return words
    raise InvalidKey(f"{setting}: {path} must hold 32 bytes or 64 hexadecimal digits, not {len(data)} bytes")


class Signing:
    """Shared by all endpoints, so that a frame accepted by one is not accepted again by another. Thread-safe.

    Invariant: a time is never used twice, even after PHM was killed, unless the clock was set back meanwhile: the saved
    time is at most SAVE_S old, and if the clock has not advanced, a new start begins so much later.
    """

    def __init__(self, key: bytes, clock: Clock, directory: str | None = None) -> None:
        """directory: where the time is stored over a restart; None: not stored."""
        self.key = key
        self._clock = clock
        self._path = None if directory is None else Path(directory) / NAME
        self._time = 0
        self._streams: dict[tuple[int, int, int], int] = {}
        self._lock, self._file = threading.Lock(), threading.Lock()
        self._saved: object = None
        self._problem = self._lost = ""
        self._lost_until = float("inf")
        self._forged_at = float("-inf")
        self._answered = threading.Condition()
        """Guards how many saves were requested of the thread, how many of these are done, and how the last one went."""
        self._requested = self._done = 0
        self._answer = ""
        self._stop, self._wake = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._keep, name="phm-signing", daemon=True)
        self._load()

    def start(self) -> None:
        self._lost_until = self._clock.mono() + WARNED_S
        threads.start(self._thread)
        with contextlib.suppress(TimeoutError):  # a disk that hangs must not keep PHM from starting
            self.save_in_time()

    def close(self, *, ended: bool = True) -> None:
        """Save the timestamps for the last time. ended: nothing is signed after this."""
        self._stop.set()
        self._wake.set()
        self.save(ended=ended)

    def stamp(self) -> int:
        """The time for the next frame: later than all before, in units of 10 microseconds since 2015."""
        with self._lock:
            self._time = max(self._now(), self._time + 1)
            return self._time

    def check(self, frame: bytes | bytearray) -> SignatureResult:
        """Verify a complete frame with a correct checksum. Only a GOOD one is recorded."""
        if frame[0] != 0xFD or not frame[2] & 0x01:
            return SignatureResult.NONE
        expected = hashlib.sha256(self.key + bytes(frame[:-6])).digest()[:6]
        if not hmac.compare_digest(expected, bytes(frame[-6:])):
            self._forged_at = self._clock.mono()
            return SignatureResult.FORGED
        time, stream = _time_of(frame), (frame[-13], frame[5], frame[6])
        with self._lock:
            received = self._streams.get(stream)
            least = max(self._now(), self._time) - round(LATE_S * TICKS) if received is None else received + 1
            if not least <= time <= LAST:
                return SignatureResult.OLD
            self._streams[stream] = time
            self._time = max(self._time, time)
            if len(self._streams) > MAX_STREAMS:
                # The oldest: its frames would usually be too old for a new sender too.
                del self._streams[min(self._streams, key=self._streams.__getitem__)]
        return SignatureResult.GOOD

    def age_s(self, frame: bytes | bytearray) -> float:
        """How long ago a GOOD frame was signed, by the newest known time."""
        with self._lock:
            return (max(self._now(), self._time) - _time_of(frame)) / TICKS

    def ahead_s(self) -> float:
        """How far the newest received or stored time is ahead of this computer's clock; 0: it is not."""
        with self._lock:
            return max(0, self._time - self._now()) / TICKS

    def problem(self) -> str:
        """A sentence if there is a problem now, else empty."""
        if self._clock.mono() - self._forged_at <= FORGED_SHOWN_S:
            return "MAVLink frames with a wrong signature were received: their sender has another key, or forges frames"
        return self._problem or (self._lost if self._clock.mono() < self._lost_until else "")

    # ------------------------------------------------------------ over a restart

    def save(self, *, ended: bool = False) -> str:
        """Store the time and the senders now. Returns a sentence if that failed, as does `problem`. Waits for the disk. ended: nothing
        is signed after this."""
        if self._path is None:
            return ""
        with self._file:
            # With the file's lock held: an older state must not replace a newer one.
            with self._lock:
                newest = sorted(self._streams.items(), key=lambda item: item[1])[-KEPT_STREAMS:]
                state = {"v": 1, "time": self._time, "streams": [[*stream, time] for stream, time in newest]}
            state["ended"] = ended
            if state == self._saved:
                return ""
            try:
                _write(self._path, json.dumps(state).encode("ascii"))
            except OSError as error:
                reason = error.strerror or error
                self._problem = (
                    f"cannot write {self._path}: {reason}; signed frames could be replayed after a restart of PHM"
                )
                return self._problem
            self._saved, self._problem = state, ""
            return ""

    def save_in_time(self) -> str:
        """As `save`, in the thread of `start`. Raises TimeoutError, immediately while an earlier call has not been answered, if the disk
        does not answer within DISK_S."""
        if not self._thread.is_alive():
            return self.save()
        with self._answered:
            hangs = self._done < self._requested
            self._requested += 1
            mine = self._requested
            self._wake.set()
            if not self._answered.wait_for(lambda: self._done >= mine, 0.0 if hangs else DISK_S):
                raise TimeoutError("the disk of state_dir does not answer")
            return self._answer

    def _keep(self) -> None:
        while not self._stop.is_set():
            requested = self._requested  # before the state is read
            answer = self.save()
            with self._answered:
                self._done, self._answer = requested, answer
                self._answered.notify_all()
            self._clock.wait(self._wake, SAVE_S)
            self._wake.clear()

    def _load(self) -> None:
        if self._path is None:
            return
        try:
            with self._path.open("rb") as stream:
                data = stream.read(MAX_FILE_BYTES + 1)
            state: Any = json.loads(data) if len(data) <= MAX_FILE_BYTES else None
            time = _ticks(state["time"])
            streams = {
                (_byte(link), _byte(system), _byte(component)): _ticks(received)
                for link, system, component, received in state["streams"][:KEPT_STREAMS]
            }
        except FileNotFoundError:
            return
        except OSError as error:
            self._lost = f"cannot read {self._path}: {error.strerror or error}; signing timestamps start from the clock"
            return
        except (ValueError, KeyError, TypeError, RecursionError):
            self._lost = f"{self._path} is damaged: signing timestamps start from the clock"
            return
        # If the clock has advanced since, it bounds the times used after the save; otherwise it does not. After an orderly end there
        # are none: added at each restart, they would run ahead of the clocks of all agents, which follow.
        exact = state.get("ended") is True or self._now() > time
        self._time, self._streams = min(time if exact else time + round(SAVE_S * TICKS), LAST), streams

    def _now(self) -> int:
        return min(max(0, round((self._clock.utc() - EPOCH_S) * TICKS)), LAST)


class Signer:
    """Signing and verification for one endpoint. `refused` counts rejected frames."""

    def __init__(self, signing: Signing, link_id: int, unsigned: Callable[[int], bool]) -> None:
        """unsigned: whether messages of a number are accepted without a signature."""
        self.signing, self.link_id, self._unsigned = signing, link_id, unsigned
        self.refused = {"forged": 0, "old": 0, "unsigned": 0}

    def prepare(self, mav: Any) -> None:
        """Let a pymavlink codec sign its packed messages."""
        mav.signing.secret_key, mav.signing.link_id, mav.signing.sign_outgoing = self.signing.key, self.link_id, True

    def passes(self, message: Any, frame: bytes | bytearray, number: int) -> bool:
        """Whether a decoded message is accepted. Marks it as signed or not, and how long ago, `_age_s`."""
        seal = self.signing.check(frame)
        if seal is SignatureResult.GOOD:
            message._signed, message._link_id, message._age_s = True, frame[-13], self.signing.age_s(frame)
            return True
        if seal is SignatureResult.FORGED:
            self.refused["forged"] += 1
            return False
        if number in COMMANDS and seal is SignatureResult.NONE:
            return True  # refused later, with an answer; a copy gets none, the first was answered
        if self._unsigned(number):
            return True  # the sender of a replay could also send it unsigned
        self.refused["old" if seal is SignatureResult.OLD else "unsigned"] += 1
        return False


COMMANDS = frozenset((75, 76))
"""COMMAND_INT and COMMAND_LONG: never accepted without a signature."""
TUNNEL = 385
RADIO_STATUS = frozenset((109, 166))
"""Created by the radio itself, which has no key."""


def unsigned_of(mode: str) -> Callable[[int], bool]:
    """What `mavlink.signing.unsigned` permits."""
    if mode == "none":
        return RADIO_STATUS.__contains__
    refused = COMMANDS if mode == "all" else COMMANDS | {TUNNEL}
    return lambda number: number not in refused


def _time_of(frame: bytes | bytearray) -> int:
    """The time in the signature of a signed frame."""
    return int.from_bytes(frame[-12:-6], "little")


def _ticks(value: object) -> int:
    if type(value) is not int or not 0 <= value <= LAST:
        raise ValueError("a time is invalid")
    return value


def _byte(value: object) -> int:
    if type(value) is not int or not 0 <= value <= 255:
        raise ValueError("a number is not a byte")
    return value


def _write(path: Path, data: bytes) -> None:
    """Write completely or not at all, also if power is lost."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".new")
    with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
