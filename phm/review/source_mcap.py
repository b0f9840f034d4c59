"""Recordings in MCAP, of rosbag2 or any other program, also compressed as a whole by gzip or zstd."""

from __future__ import annotations

import gzip
import itertools
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import IO, Any, cast

from phm.review.events import Event
from phm.review.lines import Piece, Problems
from phm.review.other import GZIP, unpacked
from phm.review.recording import MOST_MESSAGE, MOST_TOPICS, Recording
from phm.review.unpack import FREE_BYTES, MOST_GROWTH, WINDOW_BYTES, ZSTD

MAGIC = b"\x89MCAP0\r\n"
MISSING = "needs mcap: install with `pip install 'phm-sidecar[report]'`"


def fits(path: Path, head: bytes) -> bool:
    return first_bytes(path, head).startswith(MAGIC)


def first_bytes(path: Path, head: bytes) -> bytes:
    """The first bytes of a file, unpacked. Of zstd the head is not enough: its blocks are larger."""
    if not head.startswith(ZSTD):
        return unpacked(head)
    try:
        with path.open("rb") as plain, _zstd(plain) as stream:
            return bytes(stream.read(16))
    except (OSError, ValueError, ImportError, _zstd_error()):
        return b""


def read(piece: Piece, problems: Problems) -> Iterator[Event]:
    """The whole file is read before the first event: whose they are may come late."""
    found = Recording(piece.path, problems)
    try:
        from phm.review import mcap_stream

        with open(piece.path, "rb") as plain:
            channels = list(itertools.islice(mcap_stream.described(plain), MOST_TOPICS))
        for channel in channels:
            found.topic(*channel)
        with _opened(piece.path) as stream:
            for row in mcap_stream.rows(stream, found.problem):
                if isinstance(row, mcap_stream.ChannelRow):
                    found.topic(*row)
                    continue
                topic = found.topics.get(row.channel)
                wanted = topic is not None and topic.reads and len(row.data) <= MOST_MESSAGE
                found.take(row.channel, row.log_time / 1e9, bytes(row.data) if wanted else None)
    except ImportError:
        found.problem(MISSING)
    except (OSError, EOFError, zlib.error, ValueError, _zstd_error()) as error:
        found.problem(f"damaged or unreadable from here on: {error or type(error).__name__}")
    yield from found.events()


@contextmanager
def _opened(path: str) -> Iterator[IO[bytes]]:
    with open(path, "rb") as plain:
        head = plain.read(4)
        plain.seek(0)
        if not head.startswith(GZIP) and head != ZSTD:
            yield plain
            return
        packed: Any = gzip.GzipFile(fileobj=plain) if head.startswith(GZIP) else _zstd(plain)
        with packed:
            yield cast(IO[bytes], _Limited(packed, FREE_BYTES + MOST_GROWTH * os.path.getsize(path)))


class _Limited:
    """A stream that unpacks, up to so many bytes."""

    def __init__(self, stream: Any, most: int) -> None:
        self._stream, self._left = stream, most

    def read(self, count: int) -> bytes:
        """Raises ValueError: more would come."""
        data = bytes(self._stream.read(count))
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"it unpacks to more than {MOST_GROWTH} times its size")
        return data


def _zstd(stream: IO[bytes]) -> Any:
    module = import_module("zstandard")
    return module.ZstdDecompressor(max_window_size=WINDOW_BYTES).stream_reader(stream, read_across_frames=True)


def _zstd_error() -> type[Exception]:
    """What zstandard raises; something that is never raised where it is not installed."""
    try:
        return cast(type[Exception], import_module("zstandard").ZstdError)
    except ImportError:
        return EOFError
