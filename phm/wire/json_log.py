"""Reading the JSON log back: rotated files in order, torn and foreign lines skipped.

Needs nothing but the standard library, so that a ground computer can read logs with this one file. The
keys of the lines are a contract: `docs/reference/logs.md`.
"""

from __future__ import annotations

import gzip
import json
import os
import re
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO, Any, cast

VERSION = 2
"""`v` of the lines that are written now. It rises only when a key changes its meaning or goes away."""

MAX_LINE = 10_000_000
"""Bytes of a line: no log has a longer one, and a compressed file can hold far more than it has bytes."""
MOST_FILES = 100
"""The highest number of a rotated file."""
COMPRESSED = ".gz"
_NUMBER = re.compile(r"[1-9][0-9]{0,2}")
_TRIES = 5
"""How often a log is opened again because it was rotated meanwhile."""


def files(path: Path | str) -> list[Path]:
    """The files of one log, oldest first: ``phm.jsonl.2.gz``, ``phm.jsonl.1``, ``phm.jsonl``; those that exist.

    `path` is the log file, or the directory that holds ``phm.jsonl``.
    """
    base = Path(path)
    if base.is_dir():
        base = base / "phm.jsonl"
    rotated: dict[int, Path] = {}
    for entry in sorted(base.parent.glob("*"), reverse=True):  # a plain file counts before its compressed copy
        number = rotated_number(base.name, entry.name)
        if number is not None:
            rotated[number] = entry
    found = [entry for _number, entry in sorted(rotated.items(), reverse=True)]
    return found + ([base] if base.exists() else [])


def rotated_number(base: str, name: str) -> int | None:
    """The number that rotation gave to `name`, a file of the log `base`; None when rotation never makes that name.

    An operator's copy, such as ``phm.jsonl.20261121``, is not part of the log.
    """
    digits = name.removesuffix(COMPRESSED).removeprefix(f"{base}.")
    if digits == name or not _NUMBER.fullmatch(digits) or int(digits) > MOST_FILES:
        return None
    return int(digits)


def read(path: Path | str) -> Iterator[dict[str, Any]]:
    """Every event of a log, oldest first, from its rotated files and the current one.

    A line that is not a JSON object is skipped: power cuts leave torn lines and runs of zero bytes. The log
    may be written and rotated meanwhile: what was there at the first step is read once and completely.
    """
    with ExitStack() as stack:
        streams: list[IO[bytes]] = []
        for _ in range(_TRIES):
            stack.close()
            found = files(path)
            streams = _open(found, stack)
            if files(path) == found:
                break
        for stream in streams:
            yield from (event for event in map(parse, _lines(stream)) if event is not None)


def _open(found: list[Path], stack: ExitStack) -> list[IO[bytes]]:
    """Open each file once, oldest first."""
    streams: dict[object, IO[bytes]] = {}
    # Newest first: a rotation between two opens then shows a file twice, never hides one.
    for file in reversed(found):
        try:
            if not file.is_file():  # opening a pipe waits for its other end
                continue
            stream: IO[bytes] = stack.enter_context(file.open("rb"))
            if file.name.endswith(COMPRESSED):
                stream = cast(IO[bytes], stack.enter_context(gzip.GzipFile(fileobj=stream)))
            key = identity(stream)
        except (OSError, EOFError, zlib.error):
            continue
        streams.setdefault(key, stream)
    return list(reversed(streams.values()))


def identity(stream: IO[bytes]) -> object:
    """Equal for a file and its compressed copy: the first line has number and stamps. Leaves the stream at its start."""
    first = stream.readline(MAX_LINE)
    stream.seek(0)
    if b'"seq"' in first:
        return first
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino


def _lines(stream: IO[bytes]) -> Iterator[bytes]:
    """Up to the first damaged part of a compressed file."""
    with suppress(OSError, EOFError, zlib.error):
        while line := stream.readline(MAX_LINE):
            yield line


def parse(line: bytes) -> dict[str, Any] | None:
    """The event of a line; None: it is not a JSON object."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return event if isinstance(event, dict) else None
