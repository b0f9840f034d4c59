"""Compressed bytes from anyone: what comes out is never larger than the caller says."""

from __future__ import annotations

import importlib
import io
from typing import Any

ZSTD = b"\x28\xb5\x2f\xfd"
WINDOW_BYTES = 1 << 27
"""The most that a stream may ask zstandard to keep in memory; its own default."""

MOST_GROWTH, FREE_BYTES = 100, 256 << 20
"""A file, and all chunks of one together, may unpack to FREE_BYTES and MOST_GROWTH times their size; recordings shrink to a half or a
tenth."""


class TooLarge(ValueError):
    """More than allowed would come out."""


def zstd(data: bytes, most: int) -> bytes:
    """Raises ValueError (TooLarge, or damaged)."""
    module = importlib.import_module("zstandard")
    unpacker = module.ZstdDecompressor(max_window_size=WINDOW_BYTES)
    try:
        with unpacker.stream_reader(io.BytesIO(data)) as stream:
            return _limited(stream.read(most + 1), most)
    except module.ZstdError as error:
        raise ValueError(str(error)) from None


def lz4(data: bytes, most: int) -> bytes:
    """Raises ValueError (TooLarge, or damaged)."""
    module: Any = importlib.import_module("lz4.frame")
    try:
        return _limited(module.LZ4FrameDecompressor().decompress(data, max_length=most + 1), most)
    except (RuntimeError, EOFError) as error:
        raise ValueError(str(error)) from None


def _limited(data: bytes, most: int) -> bytes:
    if len(data) > most:
        raise TooLarge(f"more than {most} bytes")
    return data
