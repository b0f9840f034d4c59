"""Serialized messages as the middleware delivers them, built by hand."""

from __future__ import annotations

import struct

SECOND = 1_000_000_000


def stamped(stamp_ns: int, content: bytes = b"", frame: bytes = b"map", order: str = "<") -> bytes:
    """A message that begins with a std_msgs/Header."""
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    text = frame + b"\0"
    head = struct.pack(f"{order}iII", seconds, nanoseconds, len(text)) + text
    head += bytes(-len(head) % 4)
    return bytes((0, int(order == "<"), 0, 0)) + head + content
