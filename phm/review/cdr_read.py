"""Two ROS 2 messages out of CDR: diagnostic_msgs/DiagnosticArray and rcl_interfaces/Log, from any sender.

Not by rosbags: it makes Python code of the definitions in a file, and those may come from anyone.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

from phm.review.cdr import Status

ENCODINGS = {0: ">", 1: "<"}
"""Second byte of the message: CDR, big- and little-endian."""
LEAST_STATUS = 21
"""Bytes of an empty status; a pair has at least 8. So no number of elements is larger than the message."""


class RosoutLine(NamedTuple):
    """One rcl_interfaces/Log. level: 40 ERROR, 50 FATAL."""

    level: int
    name: str
    message: str


def statuses(data: bytes) -> list[Status]:
    """The content of the message. Raises ValueError for another message."""
    reader = _Reader(data)
    reader.skip(8)
    reader.text()
    found = []
    for _ in range(reader.length(LEAST_STATUS)):
        level = reader.byte()
        name, message, hardware = reader.text(), reader.text(), reader.text()
        values = tuple((reader.text(), reader.text()) for _ in range(reader.length(8)))
        found.append(Status(level, name, message, hardware, values))
    return found


def line(data: bytes) -> RosoutLine:
    """The content of the message. Raises ValueError for another message."""
    reader = _Reader(data)
    reader.skip(8)
    level = reader.byte()
    return RosoutLine(level, reader.text(), reader.text())


class _Reader:
    def __init__(self, data: bytes) -> None:
        """data: the message with its header of four bytes."""
        if len(data) < 4 or data[0] != 0 or data[1] not in ENCODINGS:
            raise ValueError("not CDR")
        self._number = struct.Struct(f"{ENCODINGS[data[1]]}I")
        self._data, self._at = data, 4

    def skip(self, count: int) -> None:
        self._at += count

    def byte(self) -> int:
        if self._at >= len(self._data):
            raise ValueError("ends within the message")
        self._at += 1
        return self._data[self._at - 1]

    def length(self, least: int) -> int:
        """A number of elements of at least this many bytes each."""
        self._at += -self._at % 4
        if self._at + 4 > len(self._data):
            raise ValueError("ends within the message")
        (count,) = self._number.unpack_from(self._data, self._at)
        self._at += 4
        if count * least > len(self._data) - self._at + least:
            raise ValueError("more elements than bytes")
        return int(count)

    def text(self) -> str:
        count = self.length(1)
        begin, self._at = self._at, self._at + count
        if self._at > len(self._data):
            raise ValueError("ends within a text")
        return self._data[begin : self._at].rstrip(b"\0").decode("utf-8", "replace")
