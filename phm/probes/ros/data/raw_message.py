"""Reads what does not need the message type from a serialized message: the stamp of its header, and a digest of its content.

Pure. The bytes come from any participant of the domain: nothing in them is trusted.
"""

from __future__ import annotations

import hashlib
import struct

_ENCODINGS = {0: ">", 1: "<", 6: ">", 7: "<"}
"""Second byte of the encapsulation: plain CDR of version 1 or 2, big or little endian."""
_ENCAPSULATION, _STAMP = 4, 8
_FRAME = _ENCAPSULATION + _STAMP
MAX_FRAME = 1024
"""Longest `frame_id` in bytes."""
MAX_DIGESTED = 4_000_000
"""Of a longer content this many bytes at the beginning and at the end count; they take about 5 ms."""


class NoHeader(ValueError):
    """The message does not begin with a std_msgs/Header."""


def stamp_ns(data: bytes) -> int:
    """`header.stamp` in nanoseconds. Raises NoHeader if the bytes cannot be those of a header."""
    order = _ENCODINGS.get(data[1]) if len(data) >= _FRAME + 4 else None
    if order is None:
        raise NoHeader("too short, or an unknown encoding")
    seconds, nanoseconds, length = struct.unpack_from(f"{order}iII", data, _ENCAPSULATION)
    end = _FRAME + 4 + length
    if nanoseconds >= 1_000_000_000 or not 1 <= length <= MAX_FRAME or end > len(data) or data[end - 1]:
        raise NoHeader("its first fields are not a stamp and a text")
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def digest(data: bytes, *, header: bool) -> bytes:
    """A digest of the content; header: it begins with a header, whose stamp does not count."""
    content = memoryview(data)[_FRAME if header else _ENCAPSULATION :]
    found = hashlib.blake2b(len(content).to_bytes(8, "little"), digest_size=16)
    if len(content) <= 2 * MAX_DIGESTED:
        found.update(content)
    else:
        found.update(content[:MAX_DIGESTED])
        found.update(content[-MAX_DIGESTED:])
    return found.digest()
