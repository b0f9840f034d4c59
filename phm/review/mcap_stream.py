"""MCAP as a stream of channels and messages, in bounded memory; what is damaged is counted and left out.

The records are parsed by the library `mcap`. Its readers are not used: they unpack a chunk of any size, need the index at the
end, which a recorder that lost power did not write, and end at the first damaged chunk.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import IO, Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from phm.core.extras import remedy
from phm.review import decompression

MAGIC = b"\x89MCAP0\r\n"
MOST_CHUNK = 64 << 20
"""Bytes of a chunk, packed or unpacked. Recorders begin a new one after 1 to 4 MB, but one message may be larger."""
MOST_RECORD = 1 << 20
"""Maximum number of bytes of a description."""
MOST_SCHEMAS = 10_000
BLOCK = 1 << 20
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER = struct.Struct("<BQQQI")
_FOOTER_BYTES = _FOOTER.size + len(MAGIC)
MOST_SUMMARY = 16 << 20
_DAMAGE = (McapError, ValueError, struct.error, OverflowError)
Problem = Callable[[str], None]


class ChannelRow(NamedTuple):
    """A channel of the file. kind: name of its schema; empty: none."""

    number: int
    topic: str
    kind: str
    encoding: str


class MessageRow(NamedTuple):
    """log_time in nanoseconds; data is a view that is good until the next one."""

    channel: int
    log_time: int
    data: memoryview


@dataclass
class _State:
    problem: Problem
    schemas: dict[int, str] = field(default_factory=dict)
    packed: int = 0
    unpacked: int = 0


def rows(stream: IO[bytes], problem: Problem) -> Iterator[ChannelRow | MessageRow]:
    """In the order of the file. stream: at its beginning; raises what it raises."""
    state = _State(problem)
    if stream.read(len(MAGIC)) != MAGIC:
        problem("not MCAP")
        return
    while head := _read(stream, _HEAD.size):
        if len(head) < _HEAD.size:
            problem("ends within a record")
            return
        opcode, length = _HEAD.unpack(head)
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        most = {Opcode.CHUNK: MOST_CHUNK, Opcode.MESSAGE: MOST_CHUNK, Opcode.SCHEMA: MOST_RECORD}.get(opcode, 0)
        most = MOST_RECORD if opcode == Opcode.CHANNEL else most
        if length > most:
            if most:
                problem(f"records of more than {most} bytes, left out")
            if not _skip(stream, length):
                problem("ends within a record")
                return
            continue
        body = _read(stream, length)
        state.packed += len(body)
        yield from _record(state, opcode, memoryview(body))
        if len(body) < length:
            problem("ends within a record")
            return
        if state.unpacked > decompression.FREE_BYTES + decompression.MOST_GROWTH * state.packed:
            problem(
                f"chunks that unpack to more than {decompression.MOST_GROWTH} times their size: the rest is left out"
            )
            return
    problem("ends without its last record: the recorder was not stopped")


def described(stream: IO[bytes]) -> Iterator[ChannelRow]:
    """The channels as the summary at the end repeats them, because the chunk that describes them may be damaged. Nothing where the
    summary is not whole."""
    state = _State(lambda what: None)
    try:
        end = stream.seek(-_FOOTER_BYTES, io.SEEK_END)
        footer = stream.read(_FOOTER_BYTES)
        opcode, _, start, _, _ = _FOOTER.unpack_from(footer)
        if opcode != Opcode.FOOTER or not footer.endswith(MAGIC) or not 0 < start < end or end - start > MOST_SUMMARY:
            return
        stream.seek(start)
        data = memoryview(_read(stream, end - start))
    except (OSError, struct.error):
        return
    for row in _records(state, data):
        if isinstance(row, ChannelRow):
            yield row


def _record(state: _State, opcode: int, body: memoryview) -> Iterator[ChannelRow | MessageRow]:
    if opcode == Opcode.MESSAGE:
        if len(body) < _MESSAGE.size:
            state.problem("damaged records, left out")
            return
        channel, _, log_time, _ = _MESSAGE.unpack_from(body)
        yield MessageRow(channel, log_time, body[_MESSAGE.size :])
    elif opcode == Opcode.CHUNK:
        yield from _chunk(state, body)
    elif opcode in (Opcode.CHANNEL, Opcode.SCHEMA):
        try:
            made: Any = (Channel if opcode == Opcode.CHANNEL else Schema).read(ReadDataStream(io.BytesIO(body)))
        except _DAMAGE:
            state.problem("damaged records, left out")
            return
        if opcode == Opcode.CHANNEL:
            yield ChannelRow(made.id, made.topic, state.schemas.get(made.schema_id, ""), made.message_encoding)
        elif len(state.schemas) < MOST_SCHEMAS:
            state.schemas[made.id] = made.name[:200]


def _chunk(state: _State, body: memoryview) -> Iterator[ChannelRow | MessageRow]:
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(body)))
        data = memoryview(_unpacked(chunk))
        if len(data) < chunk.uncompressed_size:
            state.problem("chunks that are not complete: what is there is read")
        elif chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("wrong checksum")
    except decompression.TooLarge:
        state.problem("chunks that unpack to more than they say, or than is read: left out")
        state.unpacked += MOST_CHUNK
        return
    except ImportError as error:
        state.problem(f"compressed chunks, for which {error.name} is missing: {remedy('report')}")
        return
    except _DAMAGE:
        state.problem("damaged chunks, left out")
        return
    state.unpacked += len(data)
    yield from _records(state, data)


def _records(state: _State, data: memoryview) -> Iterator[ChannelRow | MessageRow]:
    """The records in an unpacked chunk or in the summary."""
    at = 0
    while at + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at or not opcode:
            state.problem("chunks that end within a record")
            return
        if opcode != Opcode.CHUNK:
            yield from _record(state, opcode, data[at : at + length])
        at += length


def _unpacked(chunk: Chunk) -> bytes:
    """Raises ValueError: damaged, or larger than it says."""
    most = chunk.uncompressed_size
    if most > MOST_CHUNK:
        raise decompression.TooLarge(str(most))
    if chunk.compression == "zstd":
        return decompression.zstd(chunk.data, most)
    if chunk.compression == "lz4":
        return decompression.lz4(chunk.data, most)
    if chunk.compression:
        raise ValueError(chunk.compression)
    return chunk.data[:most]


def _read(stream: IO[bytes], count: int) -> bytes:
    """This many bytes, fewer at the end: a stream that unpacks may return less per read. Memory grows with what is there."""
    parts, left = list[bytes](), count
    while left and (part := stream.read(min(left, BLOCK))):
        parts.append(part)
        left -= len(part)
    return b"".join(parts)


def _skip(stream: IO[bytes], count: int) -> bool:
    """Skip bytes; return whether the file had this many."""
    while count:
        part = stream.read(min(count, BLOCK))
        if not part:
            return False
        count -= len(part)
    return True
