"""diagnostic_msgs/DiagnosticArray in CDR (little-endian), as ROS 2 sends it and MCAP stores it."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

TYPE = "diagnostic_msgs/msg/DiagnosticArray"
_LINE = "=" * 80
DEFINITION = f"""std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: diagnostic_msgs/DiagnosticStatus
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
{_LINE}
MSG: diagnostic_msgs/KeyValue
string key
string value
"""
"""The definition with all that it contains, as an MCAP schema of the encoding `ros2msg` has it."""
_HEADER = b"\x00\x01\x00\x00"


class Status(NamedTuple):
    """One diagnostic_msgs/DiagnosticStatus. level: 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    level: int
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...] = ()


def diagnostic_array(t: float, statuses: Iterable[Status]) -> bytes:
    """A DiagnosticArray in CDR. t: UTC seconds of the header's stamp."""
    out = bytearray(struct.pack("<iI", *divmod(_nanoseconds(t), 1_000_000_000)))
    _string(out, "")
    array = list(statuses)
    _number(out, len(array))
    for status in array:
        out.append(status.level)
        for text in (status.name, status.message, status.hardware_id):
            _string(out, text)
        _number(out, len(status.values))
        for pair in status.values:
            for text in pair:
                _string(out, text)
    return _HEADER + bytes(out)


def _nanoseconds(t: float) -> int:
    return min(max(0, round(t * 1e6)) * 1000, 2_147_483_647 * 1_000_000_000)


def _number(out: bytearray, value: int) -> None:
    """Add a number, aligned to 4 bytes, counted after the header."""
    out += bytes(-len(out) % 4)
    out += struct.pack("<I", value)


def _string(out: bytearray, text: str) -> None:
    data = text.replace("\0", " ").encode("utf-8", "replace") + b"\0"
    _number(out, len(data))
    out += data
