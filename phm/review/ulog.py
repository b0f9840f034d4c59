"""PX4's ULog as messages. Not by pyulog: it keeps all in memory, expands nested types of any size, and prints to stdout."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from phm.review.lines import Problems

MAGIC = b"ULog\x01\x12\x35"
HEADER = 16
SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
KNOWN = frozenset(b"BFIMPQALCDSOR")
"""Types of messages; of another type the stream continues at the next message SYNC."""
MOST_FORMAT_BYTES = 1_000_000
"""Of all definitions together; PX4 writes some 30,000."""
MOST_TOPICS = 64
_TYPES = {
    "int8_t": "b", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I", "int64_t": "q",
    "uint64_t": "Q", "float": "f", "double": "d", "bool": "?", "char": "c",
}  # fmt: skip
_DEEPEST = 8
_LARGEST = 65_535


@dataclass
class _Definitions:
    """Formats by name, and where the wanted fields of subscribed messages lie."""

    formats: dict[str, list[tuple[str, int, str]]] = field(default_factory=dict)
    bytes: int = 0
    topics: dict[int, tuple[str, dict[str, tuple[int, str]]]] = field(default_factory=dict)

    def size(self, kind: str, depth: int = 0) -> int:
        """Bytes of a type. ValueError: it is not defined, nested too deeply or too large."""
        if kind in _TYPES:
            return struct.calcsize(f"<{_TYPES[kind]}")
        if not self.formats.get(kind) or depth > _DEEPEST:
            raise ValueError(kind)
        whole = 0
        for each, count, _ in self.formats[kind]:
            whole += count * self.size(each, depth + 1)
            if whole > _LARGEST:
                raise ValueError(kind)
        return whole

    def fields(self, name: str, labels: frozenset[str]) -> dict[str, tuple[int, str]]:
        """Offset and struct code of each plain field of these."""
        found, at = dict[str, tuple[int, str]](), 0
        for kind, count, label in self.formats.get(name, []):
            if label in labels and kind in _TYPES and kind != "char" and count == 1:
                found[label] = (at, f"<{_TYPES[kind]}")
            at += count * self.size(kind)
            if at > _LARGEST:
                raise ValueError(name)
        return found


def messages(
    blocks: Iterable[bytes], wanted: frozenset[str], labels: frozenset[str], problems: Problems, path: str
) -> Iterator[tuple[str, dict[str, Any]]]:
    """("parameter", {name, value}), ("text", {level, timestamp, text}), and (topic, fields with these labels) of the first
    instance of each wanted topic."""
    known, buffer, at = _Definitions(), b"", HEADER
    for block in blocks:
        buffer += block
        while at + 3 <= len(buffer):
            size, kind = buffer[at] | buffer[at + 1] << 8, buffer[at + 2]
            if kind not in KNOWN:
                found = buffer.find(SYNC, at)
                problems.add("bytes that are not a message of a ULog, skipped", path)
                at = found if found >= 0 else max(at + 1, len(buffer) - len(SYNC) + 1)
                continue
            if at + 3 + size > len(buffer):
                break
            try:
                yield from _message(known, chr(kind), buffer[at + 3 : at + 3 + size], wanted, labels)
            except (ValueError, IndexError, struct.error):
                problems.add("a damaged message of a ULog, left out", path)
            at += 3 + size
        buffer, at = buffer[at:], max(0, at - len(buffer))
    if buffer:
        problems.add("ends within a message", path)


def _message(
    known: _Definitions, kind: str, body: bytes, wanted: frozenset[str], labels: frozenset[str]
) -> Iterator[tuple[str, dict[str, Any]]]:
    if kind == "F":
        name, _, rest = _text(body).partition(":")
        known.bytes += len(body)
        if known.bytes > MOST_FORMAT_BYTES:
            raise ValueError(name)
        known.formats[name] = [_field(each) for each in rest.split(";") if each]
    elif kind == "A":
        name = _text(body[3:])
        if name in wanted and body[0] == 0 and len(known.topics) < MOST_TOPICS:
            known.topics[struct.unpack_from("<H", body, 1)[0]] = (name, known.fields(name, labels))
    elif kind == "D":
        topic = known.topics.get(struct.unpack_from("<H", body)[0])
        if topic is not None:
            yield topic[0], {label: struct.unpack_from(code, body, 2 + at)[0] for label, (at, code) in topic[1].items()}
    elif kind in "LC":
        begin = 1 if kind == "L" else 3
        (stamp,) = struct.unpack_from("<Q", body, begin)
        yield "text", {"level": body[0] - ord("0"), "timestamp": stamp, "text": _text(body[begin + 8 :])}
    elif kind == "P":
        kind_name = _text(body[1 : 1 + body[0]]).split(" ")
        if kind_name[0] in ("int32_t", "float"):
            (value,) = struct.unpack_from(f"<{_TYPES[kind_name[0]]}", body, 1 + body[0])
            yield "parameter", {"name": kind_name[1], "value": value}


def _field(text: str) -> tuple[str, int, str]:
    """Type, number of elements and name of ``float[3] position``."""
    kind, _, label = text.partition(" ")
    base, _, count = kind.partition("[")
    number = int(count.rstrip("]")) if count else 1
    if number < 1:
        raise ValueError(text)
    return base, number, label


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")
