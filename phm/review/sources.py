"""Kinds of records. A kind is one entry of `SOURCES`: how to recognize a file, and how to read it.

To add one: write a module with `fits(path, head) -> bool` and `read(segment, problems) -> Iterator[Event]`, and add it to
`SOURCES`. `divisible`: a file can be read in segments, by several processes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from phm.review import source_dataflash, source_mcap, source_rosbag2, source_tlog, source_ulog
from phm.review.events import Event, parse
from phm.review.lines import FileSegment, Problems, lines

NAME = re.compile(r".+\.(?:jsonl|ndjson)(?:\.[1-9][0-9]{0,2})?(?:\.gz)?")
"""Files of JSON lines, as logs and their rotation name them."""


@dataclass(frozen=True)
class Source:
    """fits: whether a file is such a record, from its path and its first bytes. read: its events, in any order."""

    name: str
    fits: Callable[[Path, bytes], bool]
    read: Callable[[FileSegment, Problems], Iterator[Event]]
    divisible: bool = False


def _json_lines(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    for number, line in enumerate(lines(segment, problems), 1):
        event, wrong = parse(line)
        if wrong and line.strip(b"\0 \r\n"):
            problems.add(wrong, segment.path, number)
        if event is not None:
            yield event


def _is_json_lines(path: Path, head: bytes) -> bool:
    return NAME.fullmatch(path.name) is not None


SOURCES: tuple[Source, ...] = (
    Source("JSON lines", _is_json_lines, _json_lines, divisible=True),
    Source("DataFlash", source_dataflash.fits, source_dataflash.read),
    Source("ULog", source_ulog.fits, source_ulog.read),
    Source("MCAP", source_mcap.fits, source_mcap.read),
    Source("rosbag2", source_rosbag2.fits, source_rosbag2.read),
    Source("tlog", source_tlog.fits, source_tlog.read),
)


def source_of(path: Path) -> Source | None:
    """The kind of the record at `path`; None: it is none that is known."""
    head = _head(path)
    return next((source for source in SOURCES if source.fits(path, head)), None)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as stream:
            return stream.read(4096)
    except OSError:
        return b""
