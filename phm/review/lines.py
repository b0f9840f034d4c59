"""Lines of a file or of a segment of it, in bounded memory, whatever the file contains."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import IO, cast

from phm.review.decompression import FREE_BYTES, MOST_GROWTH
from phm.wire.json_log import COMPRESSED

MAX_LINE = 2_000_000
"""Bytes. The longest real line is a snapshot of 256 agents, well below this."""
BLOCK = 1 << 20
MOST_PROBLEMS = 200


@dataclass
class Problems:
    """What could not be read: for each kind of problem and file how often, and the first place."""

    found: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    more: int = 0

    def add(self, what: str, path: str, line: int = 0, count: int = 1) -> None:
        """Count a problem of this kind in a file. line: number in the file, or in the segment of it; 0: unknown."""
        entry = self.found.get((what, path))
        if entry is not None:
            entry[0] += count
        elif len(self.found) < MOST_PROBLEMS:
            self.found[what, path] = [count, line]
        else:
            self.more += count

    def merge(self, other: Problems) -> None:
        for (what, path), (count, line) in other.found.items():
            self.add(what, path, line, count)
        self.more += other.more


@dataclass(frozen=True)
class FileSegment:
    """Bytes `begin` to `end` of a file; a line belongs to the segment in which it begins. end None: to its end."""

    path: str
    begin: int = 0
    end: int | None = None


def lines(segment: FileSegment, problems: Problems) -> Iterator[bytes]:
    """Each complete or torn line, without those that are longer than MAX_LINE."""
    try:
        with open(segment.path, "rb") as plain:
            if segment.path.endswith(COMPRESSED):
                most = FREE_BYTES + MOST_GROWTH * os.path.getsize(segment.path)
                with gzip.GzipFile(fileobj=plain) as packed:
                    yield from _lines(cast(IO[bytes], packed), replace(segment, end=most), problems)
                    if packed.tell() >= most:
                        problems.add(
                            f"it unpacks to more than {MOST_GROWTH} times its size: the rest was not read", segment.path
                        )
            else:
                yield from _lines(plain, segment, problems)
    except (OSError, EOFError, zlib.error) as error:
        problems.add(f"damaged or unreadable from here on: {error or type(error).__name__}", segment.path)


def _lines(stream: IO[bytes], segment: FileSegment, problems: Problems) -> Iterator[bytes]:
    place = segment.begin
    if place:
        stream.seek(place - 1)
        place += _skip(stream) - 1  # the rest of a line that began in the segment before
    number = 0
    while segment.end is None or place < segment.end:
        line = stream.readline(MAX_LINE + 1)
        if not line:
            return
        number += 1
        place += len(line)
        if len(line) > MAX_LINE:
            place += 0 if line.endswith(b"\n") else _skip(stream)
            problems.add(f"line longer than {MAX_LINE} bytes", segment.path, number)
            continue
        yield line


def _skip(stream: IO[bytes]) -> int:
    """Read to the end of the line; return the number of bytes."""
    skipped = 0
    while part := stream.readline(BLOCK):
        skipped += len(part)
        if part.endswith(b"\n"):
            break
    return skipped
