"""Output of a container without a terminal: the engine sends it in frames with a header of eight bytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_HEADER = 8
_ERRORS = 2


def beginning(raw: Any, limit: int) -> bytes:
    """The first `limit` bytes of a response's body, `requests.Response.raw`."""
    data = b""
    while len(data) < limit and (more := raw.read(min(65536, limit - len(data)))):
        data += more
    return data


def split(data: bytes) -> tuple[bytes, bytes]:
    """Standard output and standard error."""
    parts = list(_frames(data))
    return b"".join(part for errors, part in parts if not errors), b"".join(part for errors, part in parts if errors)


def merged(data: bytes) -> bytes:
    """All output in the order in which it came."""
    return b"".join(part for _, part in _frames(data))


def _frames(data: bytes) -> Iterator[tuple[bool, bytes]]:
    """Whether it is standard error, and the content. Data without frames, as of a container with a terminal, are output; a frame
    that was cut counts as far as it came."""
    if not _framed(data, 0):
        yield False, data
        return
    at = 0
    while _framed(data, at):
        size = int.from_bytes(data[at + 4 : at + _HEADER], "big")
        yield data[at] == _ERRORS, data[at + _HEADER : at + _HEADER + size]
        at += _HEADER + size


def _framed(data: bytes, at: int) -> bool:
    return len(data) - at >= _HEADER and data[at] in (0, 1, _ERRORS) and data[at + 1 : at + 4] == b"\0\0\0"
