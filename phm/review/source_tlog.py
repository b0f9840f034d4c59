"""Telemetry logs (`.tlog`, also compressed): frames of MAVLink, each after 8 bytes with its time in microseconds of UTC."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.review import autopilot_names as names
from phm.review.decompression import gunzipped
from phm.review.events import Event
from phm.review.external_entry import EARLIEST_S, blocks, text_event
from phm.review.lines import FileSegment, Problems

V1, V2, SIGNED = 0xFE, 0xFD, 0x01
MARKER = re.compile(rb"[\xfd\xfe]")
LATEST_S = 4_102_444_800.0
"""2100: a later time is none, so that the reader finds the next frame in damaged bytes."""
STAMP = 8
LONGEST = STAMP + 280
HEARTBEAT, STATUSTEXT = 0, 253
ARMED, NO_AUTOPILOT, CRITICAL, EMERGENCY = 128, 8, 5, 6
FULL_TEXT = 50
MOST_SENDERS = 256
SAME_S = 1.0
"""The same text of the same sender within this time came by several links."""


def fits(path: Path, head: bytes) -> bool:
    first = gunzipped(head)
    return len(first) > STAMP and first[STAMP] in (V1, V2) and _stamp(first, 0) is not None


def read(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    from phm.transport.dialect import mavlink

    log = _Log()
    decoder = mavlink.MAVLink(None)
    for t, frame in _frames(segment.path, problems):
        number = frame[5] if frame[0] == V1 else int.from_bytes(frame[7:10], "little")
        if number not in (HEARTBEAT, STATUSTEXT):
            continue
        try:
            message = decoder.decode(bytearray(frame))
        except Exception:  # pymavlink's decoders raise many exception types on hostile bytes
            problems.add("a frame with a wrong checksum, left out", segment.path)
            continue
        yield from log.heartbeat(t, message) if number == HEARTBEAT else log.text(t, message)


class _Log:
    """Collects the changes of each sender."""

    def __init__(self) -> None:
        self._modes: dict[int, int] = {}
        self._armed: dict[int, bool] = {}
        self._status: dict[int, int] = {}
        self._texts: dict[tuple[str, str], float] = {}
        self._parts: dict[tuple[str, int], str] = {}

    def heartbeat(self, t: float, message: Any) -> Iterator[Event]:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if message.autopilot == NO_AUTOPILOT or component != 1:
            return
        if self._modes.get(system) != message.custom_mode:
            self._modes[system] = message.custom_mode
            yield Event("mode", system=system, utc_s=t, text=_mode(message))
        armed = bool(message.base_mode & ARMED)
        if self._armed.get(system, False) is not armed:
            yield Event("arming", system=system, utc_s=t, text="armed" if armed else "disarmed", began=armed)
        self._armed[system] = armed
        status, before = message.system_status, self._status.get(system)
        self._status[system] = status
        if status != before and status in (CRITICAL, EMERGENCY):
            word = "CRITICAL" if status == CRITICAL else "EMERGENCY"
            yield Event("failsafe", system=system, utc_s=t, text=f"state {word}", level="ERROR", began=True)
        elif status != before and before in (CRITICAL, EMERGENCY):
            yield Event("failsafe", system=system, utc_s=t, text="state is normal again")

    def text(self, t: float, message: Any) -> Iterator[Event]:
        by = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        words, part = str(message.text), int(getattr(message, "id", 0))
        if part:
            if len(self._parts) >= MOST_SENDERS:
                self._parts.clear()
            whole = self._parts.pop((by, part), "") + words if message.chunk_seq else words
            if len(words) >= FULL_TEXT and len(whole) < 255 * FULL_TEXT:
                self._parts[by, part] = whole
                return
            words = whole
        if t - self._texts.get((by, words), -SAME_S) < SAME_S:
            return
        if len(self._texts) >= MOST_SENDERS:
            self._texts.clear()
        self._texts[by, words] = t
        level = "ERROR" if message.severity <= 3 else "WARN" if message.severity == 4 else ""
        yield text_event(message.get_srcSystem(), t, words, by, level)


def _mode(message: Any) -> str:
    if message.autopilot == names.ARDUPILOT:
        return names.ardupilot_mode(names.vehicle_of(message.type), message.custom_mode)
    return names.px4_mode(message.custom_mode) if message.autopilot == names.PX4 else f"mode {message.custom_mode}"


def _frames(path: str, problems: Problems) -> Iterator[tuple[float, bytes]]:
    """Times and frames; the checksum is not examined here."""
    buffer, skipping = b"", False
    for block in blocks(path, problems):
        buffer, at = buffer + block, 0
        while at + LONGEST <= len(buffer):
            t, length = _stamp(buffer, at), _length(buffer, at + STAMP)
            if t is None or not length:
                if not skipping:
                    problems.add("bytes that are not a frame, skipped", path)
                skipping, at = True, _next(buffer, at + 1)
                continue
            skipping = False
            yield t, buffer[at + STAMP : at + STAMP + length]
            at += STAMP + length
        buffer = buffer[at:]
    yield from _rest(buffer, path, problems)


def _rest(buffer: bytes, path: str, problems: Problems) -> Iterator[tuple[float, bytes]]:
    """The frames at the end, of which the last may be torn."""
    at = 0
    while at + STAMP + 3 <= len(buffer):
        t, length = _stamp(buffer, at), _length(buffer, at + STAMP)
        end = at + STAMP + length
        if t is None or not length or end > len(buffer):
            at = _next(buffer, at + 1)
            continue
        yield t, buffer[at + STAMP : end]
        at = end
        buffer, at = buffer[at:], 0
    if buffer:
        problems.add("ends within a frame", path)


def _next(buffer: bytes, at: int) -> int:
    """The place at which the next stamp and frame may begin."""
    found = MARKER.search(buffer, at + STAMP)
    return found.start() - STAMP if found else max(at, len(buffer) - STAMP)


def _stamp(data: bytes, at: int) -> float | None:
    t = int.from_bytes(data[at : at + STAMP], "big") / 1e6
    return t if EARLIEST_S < t < LATEST_S else None


def _length(data: bytes, at: int) -> int:
    """The length of the frame at this place; 0: there is none."""
    marker = data[at]
    if marker == V1:
        return data[at + 1] + 8
    if marker != V2 or data[at + 2] & ~SIGNED:
        return 0
    return data[at + 1] + 12 + (13 if data[at + 2] & SIGNED else 0)
