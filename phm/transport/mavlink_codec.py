"""MAVLink messages to bytes and back: one codec per endpoint, one parser per stream.

The parser finds frames itself and passes only complete frames to pymavlink. pymavlink's own buffer grows as long as a
stream never ends at the end of a frame, and it loses up to 280 valid bytes after each false start; here an invalid
frame costs one byte.
"""

from __future__ import annotations

import copy
import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from phm.core.duplicate_filter import DuplicateFilter
from phm.transport.dialect import SAME, mavlink
from phm.transport.mavlink_signing import SIGNATURE_BYTES, Signer
from phm.transport.mavlink_traffic import SenderTable

V1, V2 = 0xFE, 0xFD
_MARKERS = frozenset((V1, V2))
_MARKER = re.compile(b"[\xfe\xfd]")
_SIGNED = 0x01
_RECENT_FRAMES = 256
FALSE_FRAMES = 8
"""After this many invalid frames the rest of a datagram is dropped. Each is a checksum over up to 280 bytes in Python, and in one of
64 kB every byte could begin one."""

Wanted = Callable[[int], bool]
"""Whether a listener wants messages of this id."""


@dataclass(slots=True)
class LinkCounters:
    """Counters of one endpoint since its start. `bad` counts false starts: bytes or frames that are invalid."""

    sent: int = 0
    received: int = 0
    dropped: int = 0
    bad: int = 0
    bytes_out: int = 0
    bytes_in: int = 0
    frame_bytes: int = 0
    """Of the frames in `received`."""
    verified: int = 0
    """The part of `received` whose checksum was computed."""


class Codec:
    """Packs with its own sequence, so that receivers can count this endpoint's losses."""

    def __init__(self, system_id: int, component_id: int, wanted: Wanted, signer: Signer | None = None) -> None:
        """signer: signs packed messages and verifies parsed ones; None: signing is off."""
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        # For sizes: packing with it changes no sequence and signs nothing.
        self._scale = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        # Also for decoding: without a key, pymavlink does not verify signatures (`phm.transport.mavlink_signing` does).
        self._signer = signer
        if signer is not None:
            signer.prepare(self._mav)
        self._wanted = wanted
        self._recent: DuplicateFilter[bytes, bool] = DuplicateFilter(_RECENT_FRAMES)
        self._lock = threading.Lock()
        self.counters = LinkCounters()
        self.senders = SenderTable()

    @property
    def signs(self) -> bool:
        """Whether signing is on."""
        return self._signer is not None

    def pack(self, message: Any) -> bytes:
        """The frame of a message. Packing writes into the message, and other endpoints pack it too: pass a copy."""
        if self._signer is not None:
            self._mav.signing.timestamp = self._signer.signing.stamp()
        frame: bytes = copy.copy(message).pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        with self._lock:
            self._recent.add(frame, True)
        return frame

    def size(self, message: Any) -> int:
        """Size of the message's frame in bytes."""
        return len(copy.copy(message).pack(self._scale)) + (SIGNATURE_BYTES if self._signer is not None else 0)

    def sent(self, frame: bytes) -> bool:
        """Whether this exact frame was sent here recently: then receiving it is an echo."""
        with self._lock:
            return self._recent.get(frame) is not None

    def parser(self) -> Parser:
        return Parser(self._scale, self._wanted, self.counters, self.senders, self._signer)

    def refused(self) -> dict[str, int]:
        """Number of frames rejected because of their signature, by reason; empty if signing is off."""
        return dict(self._signer.refused) if self._signer is not None else {}


class Parser:
    """Finds frames in one stream of bytes. No input raises; at most one frame is kept."""

    def __init__(
        self, mav: Any, wanted: Wanted, counters: LinkCounters, senders: SenderTable, signer: Signer | None = None
    ) -> None:
        self._mav, self._wanted, self._counters, self._senders = mav, wanted, counters, senders
        self._signer = signer
        self._buffer = bytearray()
        self.verified = 0
        """Frames whose checksum was computed and is correct."""

    def datagram(self, data: bytes, *, verify: bool = False) -> list[Any]:
        """Like `feed`; a frame never continues in the next datagram, and it ends after FALSE_FRAMES."""
        messages = self._parse(data, verify, FALSE_FRAMES, ends=True)
        if self._buffer:
            self._counters.bad += 1
            self._buffer.clear()
        return messages

    def feed(self, data: bytes, *, verify: bool = False) -> list[Any]:
        """Messages that a listener wants. Others are skipped by their length, unless `verify` requests their checksum."""
        return self._parse(data, verify, float("inf"), ends=False)

    def _parse(self, data: bytes, verify: bool, false_frames: float, *, ends: bool) -> list[Any]:
        """false_frames: stop after so many invalid frames, and keep the rest. ends: the last frame ends with the data."""
        self._buffer += data
        self._counters.bytes_in += len(data)
        messages, at, garbage = [], 0, False
        while at < len(self._buffer) and false_frames > 0:
            length = self._length(at)
            if length < 0 or len(self._buffer) - at < length:
                break
            before = self.verified
            good, message = self._judge(at, length, verify, ends) if length else (False, None)
            if good is None:
                break
            false_frames -= bool(length and not good)
            if good:
                self._count(at, length, verified=self.verified > before)
                if message is not None:
                    messages.append(message)
            elif not garbage:
                self._counters.bad += 1
            garbage = not good
            at = at + length if good else self._next_start(at + 1)
        del self._buffer[:at]
        return messages

    def _count(self, at: int, length: int, *, verified: bool) -> None:
        """Count an accepted frame."""
        self._counters.received += 1
        self._counters.frame_bytes += length
        self._counters.verified += verified
        number, system, component = self._head(at)
        # Bytes that were read at a wrong speed contain frames by chance, each of another sender.
        if verified or (system, component) in self._senders:
            self._senders.receive(system, component, number)

    def _head(self, at: int) -> tuple[int, int, int]:
        """Sequence number, system and component of the frame that starts here."""
        first = at + (2 if self._buffer[at] == V1 else 4)
        return self._buffer[first], self._buffer[first + 1], self._buffer[first + 2]

    def _next_start(self, at: int) -> int:
        """Where the next frame may begin, from there on; the end of the buffer if none may."""
        found = _MARKER.search(self._buffer, at)
        return found.start() if found is not None else len(self._buffer)

    def _length(self, at: int) -> int:
        """Length of the frame that starts here; 0 if none does; -1 if more bytes are needed."""
        marker = self._buffer[at]
        if marker not in _MARKERS:
            return 0
        if len(self._buffer) - at < 3:
            return -1
        if marker == V1:
            return self._buffer[at + 1] + 8
        flags = self._buffer[at + 2]
        if flags & ~_SIGNED:
            return 0  # the standard requires dropping frames with unknown flags
        return self._buffer[at + 1] + 12 + (SIGNATURE_BYTES if flags & _SIGNED else 0)

    def _judge(self, at: int, length: int, verify: bool, ends: bool) -> tuple[bool | None, Any]:
        """Whether these bytes are a frame (None: the next byte decides), and its message if a listener wants it."""
        frame = self._buffer[at : at + length]
        number = frame[5] if frame[0] == V1 else int.from_bytes(frame[7:10], "little")
        known, wanted = number in mavlink.mavlink_map, self._wanted(SAME.get(number, number))
        if not known or not (verify or wanted or self._head(at)[1:] not in self._senders):
            # No checksum without the message's definition, nor for what only a known sender's count needs: such a frame is
            # accepted if another one follows it.
            end = at + length
            if end == len(self._buffer):
                # A stream is read in pieces of any size: that one ends here proves nothing.
                return (True if ends else None), None
            return self._buffer[end] in _MARKERS, None
        try:
            message = self._mav.decode(frame)
        except Exception:  # pymavlink's decoders raise many exception types on hostile bytes
            return False, None
        self.verified += 1
        passes = wanted and (self._signer is None or self._signer.passes(message, frame, number))
        return True, message if passes else None
