"""ArduPilot's DataFlash log as records: each type of message is described by an FMT message before it.

Not by pymavlink's DFReader: without its compiled index it never ends on an FMT message with a length of 0, it keeps the place of
every message in memory, and it reads no compressed file.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from phm.review.lines import Problems

HEAD = b"\xa3\x95"
FMT = 0x80
_CODES = {
    "a": "64s", "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s", "Z": "64s",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "q": "q", "Q": "Q", "g": "e",
}  # fmt: skip
"""A character of a format to one of the module struct. Multipliers (c, C, e, E, L) are not applied: nothing here has one."""


@dataclass(frozen=True)
class _Format:
    """The format of a message. fields: None for messages that are not used."""

    name: str
    length: int
    fields: struct.Struct | None = None
    columns: tuple[str, ...] = ()


_FIRST = _Format("FMT", 89, struct.Struct("<BB4s16s64s"), ("Type", "Length", "Name", "Format", "Columns"))


def records(
    blocks: Iterable[bytes], wanted: frozenset[str], problems: Problems, path: str
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and fields of each wanted message. Other bytes are skipped up to the next one, and counted."""
    formats, buffer = {FMT: _FIRST}, b""
    skipping = False
    for block in _with_end(blocks):
        buffer, at, last = buffer + block, 0, not block
        while at + 3 <= len(buffer):
            form = formats.get(buffer[at + 2]) if buffer.startswith(HEAD, at) else None
            end = at + (form.length if form is not None else 3)
            if form is not None and end + 2 > len(buffer) and not (last and end == len(buffer)):
                break
            # A message that is not followed by one was cut, and its rest is something else.
            if form is None or not (end == len(buffer) or buffer.startswith(HEAD, end)):
                if not skipping:
                    problems.add("bytes that are not a message of a DataFlash log, skipped", path)
                skipping, at = True, _next(buffer, at + 1)
                continue
            skipping = False
            if form.fields is not None:
                row = _row(form, buffer[at + 3 : end])
                if form.name == "FMT":
                    _define(formats, row, wanted, problems, path)
                if form.name in wanted:
                    yield form.name, row
            at = end
        buffer = buffer[at:]
    if buffer:
        problems.add("ends within a message", path)


def _with_end(blocks: Iterable[bytes]) -> Iterator[bytes]:
    yield from blocks
    yield b""


def _next(buffer: bytes, at: int) -> int:
    """Where the next message may begin; at most one byte is kept at the end."""
    found = buffer.find(HEAD, at)
    return found if found >= 0 else max(at, len(buffer) - 1)


def _row(form: _Format, body: bytes) -> dict[str, Any]:
    assert form.fields is not None
    values = form.fields.unpack_from(body)
    return {
        column: value.split(b"\0")[0].decode("utf-8", "replace") if isinstance(value, bytes) else value
        for column, value in zip(form.columns, values, strict=False)
    }


def _define(
    formats: dict[int, _Format], row: dict[str, Any], wanted: frozenset[str], problems: Problems, path: str
) -> None:
    kind, length, name = row["Type"], row["Length"], row["Name"]
    if kind == FMT:
        return
    codes = [_CODES.get(code) for code in row["Format"]]
    fields = (
        struct.Struct("<" + "".join(code for code in codes if code)) if name in wanted and None not in codes else None
    )
    if length < 3 or (fields is not None and fields.size + 3 > length):
        problems.add(f"impossible length of the messages {name[:4]!r}", path)
        formats.pop(kind, None)
        return
    formats[kind] = _Format(name, length, fields, tuple(row["Columns"].split(",")))
