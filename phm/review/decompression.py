"""Compressed bytes from anyone: what comes out is never larger than the caller says."""

from __future__ import annotations

import gzip
import importlib
import io
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, cast

GZIP, ZSTD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
WINDOW_BYTES = 1 << 27
"""The most that a stream may ask zstandard to keep in memory; its own default."""

MOST_GROWTH, FREE_BYTES = 100, 256 << 20
"""A file, and all chunks of one together, may unpack to FREE_BYTES and MOST_GROWTH times their size; recordings shrink to a half or a
tenth."""


class TooLarge(ValueError):
    """The unpacked data would be larger than allowed."""


def zstd(data: bytes, most: int) -> bytes:
    """The unpacked data. Raises ValueError: TooLarge, or the data are damaged."""
    module = importlib.import_module("zstandard")
    unpacker = module.ZstdDecompressor(max_window_size=WINDOW_BYTES)
    try:
        with unpacker.stream_reader(io.BytesIO(data)) as stream:
            return _limited(stream.read(most + 1), most)
    except module.ZstdError as error:
        raise ValueError(str(error)) from None


def lz4(data: bytes, most: int) -> bytes:
    """The unpacked data. Raises ValueError: TooLarge, or the data are damaged."""
    module: Any = importlib.import_module("lz4.frame")
    try:
        return _limited(module.LZ4FrameDecompressor().decompress(data, max_length=most + 1), most)
    except (RuntimeError, EOFError) as error:
        raise ValueError(str(error)) from None


def gunzipped(head: bytes) -> bytes:
    """The first bytes of a file, decompressed if it is compressed by gzip."""
    if not head.startswith(GZIP):
        return head
    try:
        return zlib.decompressobj(31).decompress(head, 4096)
    except zlib.error:
        return b""


def first_bytes(path: Path, head: bytes) -> bytes:
    """The first bytes of a file, decompressed if it is compressed. Of zstd the head is not enough: its blocks are larger."""
    if not head.startswith(ZSTD):
        return gunzipped(head)
    try:
        with path.open("rb") as plain, _zstd_stream(plain) as stream:
            return bytes(stream.read(16))
    except ImportError:
        return b""
    except damages():
        return b""


@contextmanager
def opened(path: str) -> Iterator[IO[bytes]]:
    """The file, decompressed if it is compressed as a whole; its `read` raises what `damages` lists."""
    with open(path, "rb") as plain:
        head = plain.read(4)
        plain.seek(0)
        if not head.startswith(GZIP) and head != ZSTD:
            yield plain
            return
        packed: Any = gzip.GzipFile(fileobj=plain) if head.startswith(GZIP) else _zstd_stream(plain)
        with packed:
            yield cast(IO[bytes], _Limited(packed, FREE_BYTES + MOST_GROWTH * os.path.getsize(path)))


def damages() -> tuple[type[Exception], ...]:
    """What reading a damaged or hostile file raises; zstandard may not be installed."""
    known = (OSError, EOFError, zlib.error, ValueError)
    try:
        return *known, importlib.import_module("zstandard").ZstdError
    except ImportError:
        return known


class _Limited:
    """A stream that unpacks at most this many bytes."""

    def __init__(self, stream: Any, most: int) -> None:
        self._stream, self._left = stream, most

    def read(self, count: int) -> bytes:
        """Read unpacked bytes. Raises ValueError if there are more than allowed."""
        data = bytes(self._stream.read(count))
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"it unpacks to more than {MOST_GROWTH} times its size")
        return data


def _zstd_stream(stream: IO[bytes]) -> Any:
    module = importlib.import_module("zstandard")
    return module.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(stream, read_across_frames=True)


def _limited(data: bytes, most: int) -> bytes:
    if len(data) > most:
        raise TooLarge(f"more than {most} bytes")
    return data
