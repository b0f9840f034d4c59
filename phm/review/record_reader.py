"""Find the files of a record and read them, in several processes when they are large."""

from __future__ import annotations

import contextlib
import gzip
import multiprocessing
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from phm.review.lines import MAX_LINE, FileSegment
from phm.review.part import Part
from phm.review.sources import Source, source_of
from phm.wire.json_log import COMPRESSED

SEGMENT_BYTES = 32_000_000
ALONE_BYTES = 24_000_000
"""Less is read faster than other processes start."""
MOST_FILES = 20_000
AHEAD = 4
"""Pieces that wait for each process: what is read but not merged yet is bounded."""
Progress = Callable[[int], None]


class NoRecord(Exception):
    """There is nothing to report about; the message says where it was looked for, and what to do."""


@dataclass
class Found:
    """The files of a record. other: files that are none."""

    files: list[tuple[Path, Source]] = field(default_factory=list)
    twice: list[Path] = field(default_factory=list)
    other: int = 0

    @property
    def bytes(self) -> int:
        return sum(path.stat().st_size for path, _ in self.files)


def find(paths: Sequence[str]) -> Found:
    """The records in files and folders (with their subfolders). Raises NoRecord."""
    found, seen = Found(), dict[bytes, int]()
    for name in paths:
        path = Path(name)
        if not path.exists():
            raise NoRecord(f"{name} does not exist: name a log, a record of `phm gcs --record`, or a folder with them")
        for file in sorted(_files(path)):
            source = source_of(file)
            if source is None:
                found.other += 1
                continue
            identity = _identity(file)
            if identity in seen:
                place = seen[identity]
                had = found.files[place]
                longer = _length(file) > _length(had[0])
                found.twice.append(had[0] if longer else file)
                found.files[place] = (file, source) if longer else had
                continue
            seen[identity] = len(found.files)
            found.files.append((file, source))
            if len(found.files) > MOST_FILES:
                raise NoRecord(f"more than {MOST_FILES} files: name fewer folders")
    if not found.files:
        raise NoRecord(
            f"no record in {', '.join(paths)}: expected phm.jsonl of an agent (its rotated files too), a file of "
            "`phm gcs --record`, an autopilot's log, or a recording of ROS 2"
        )
    return found


def read(found: Found, progress: Progress = lambda _: None, *, processes: int | None = None) -> Part:
    """All events. progress is called with numbers of bytes that were read. processes: 1 reads in this one."""
    segments = list(_segments(found))
    whole = Part()
    for file in found.twice:
        whole.problems.add("begins with the same line as another file, so it is a copy and was left out", str(file))
    count = processes or min(os.cpu_count() or 1, 8)
    if count == 1 or (processes is None and found.bytes < ALONE_BYTES):
        for segment, source in segments:
            part = _read(segment, source.name)
            whole.merge(part)
            progress(part.bytes)
        return whole
    with ProcessPoolExecutor(count, multiprocessing.get_context("spawn")) as pool:
        for part in _in_order(pool, segments, count * AHEAD):
            whole.merge(part)
            progress(part.bytes)
    return whole


def _in_order(pool: ProcessPoolExecutor, segments: list[tuple[FileSegment, Source]], most: int) -> Iterator[Part]:
    """The parts, in the order in which they are done: merging does not depend on it."""
    waiting: set[Future[Part]] = set()
    for segment, source in segments:
        waiting.add(pool.submit(_read, segment, source.name))
        if len(waiting) >= most:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from (each.result() for each in done)
    for each in waiting:
        yield each.result()


def _read(segment: FileSegment, name: str) -> Part:
    """Read one segment of a file; also runs in other processes."""
    from phm.review.sources import SOURCES

    source = next(each for each in SOURCES if each.name == name)
    part = Part()
    for event in source.read(segment, part.problems):
        part.take(event, segment.path)
    with contextlib.suppress(OSError):
        part.bytes = (segment.end or os.path.getsize(segment.path)) - segment.begin
    return part


def _segments(found: Found) -> Iterator[tuple[FileSegment, Source]]:
    for path, source in found.files:
        size = path.stat().st_size
        if not source.divisible or path.name.endswith(COMPRESSED) or size <= SEGMENT_BYTES:
            yield FileSegment(str(path)), source
            continue
        for begin in range(0, size, SEGMENT_BYTES):
            yield FileSegment(str(path), begin, min(begin + SEGMENT_BYTES, size)), source


def _files(path: Path) -> Iterator[Path]:
    if path.is_file():
        yield path
        return
    for folder, folders, names in os.walk(path):
        folders.sort()
        for name in names:
            file = Path(folder, name)
            if file.is_file() and not file.is_symlink():
                yield file


def _length(path: Path) -> int:
    """Bytes of text that can be read: a copy may have been made while the file grew, or be damaged."""
    length = 0
    try:
        if not path.name.endswith(COMPRESSED):
            return path.stat().st_size
        with gzip.open(path) as packed:
            while part := packed.read(1 << 20):
                length += len(part)
    except (OSError, EOFError, zlib.error):
        pass
    return length


def _identity(path: Path) -> bytes:
    """Equal for a file and its compressed copy: the first line has number and stamps."""
    try:
        with path.open("rb") as plain:
            if path.name.endswith(COMPRESSED):
                with gzip.GzipFile(fileobj=plain) as packed:
                    first = packed.readline(MAX_LINE)
            else:
                first = plain.readline(MAX_LINE)
    except (OSError, EOFError, zlib.error):
        first = b""
    return first if b'"seq"' in first else os.fsencode(path.resolve())
