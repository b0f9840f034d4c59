"""Reading the JSON log back: rotated files in order, torn and foreign lines skipped.

Needs nothing but the standard library, so that a ground computer can read logs with this one file. The
keys of the lines are a contract: `docs/reference/logs.md`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

VERSION = 2
"""`v` of the lines that are written now. It rises only when a key changes its meaning or goes away."""

MOST_FILES = 100
"""The highest number of rotated files that a configuration can ask for."""
_NUMBER = re.compile(r"[1-9][0-9]{0,2}")


def files(path: Path | str) -> list[Path]:
    """The files of one log, oldest first: ``phm.jsonl.2``, ``phm.jsonl.1``, ``phm.jsonl``; those that exist.

    `path` is the log file, or the directory that holds ``phm.jsonl``.
    """
    base = Path(path)
    if base.is_dir():
        base = base / "phm.jsonl"
    rotated = [
        (number, entry)
        for entry in base.parent.glob("*")
        if (number := rotated_number(base.name, entry.name)) is not None
    ]
    found = [entry for _number, entry in sorted(rotated, reverse=True)]
    return found + ([base] if base.exists() else [])


def rotated_number(base: str, name: str) -> int | None:
    """The number that rotation gave to `name`, a file of the log `base`; None when rotation never makes that name.

    An operator's copy, such as ``phm.jsonl.20261121``, is not part of the log.
    """
    digits = name.removeprefix(f"{base}.")
    if digits == name or not _NUMBER.fullmatch(digits) or int(digits) > MOST_FILES:
        return None
    return int(digits)


def read(path: Path | str) -> Iterator[dict[str, Any]]:
    """Every event of a log, oldest first, from its rotated files and the current one.

    A line that is not a JSON object is skipped: power cuts leave torn lines and runs of zero bytes. The log
    may be written and rotated meanwhile: what was there at the first step is read once and completely.
    """
    with ExitStack() as stack:
        streams: dict[tuple[int, int], IO[bytes]] = {}
        # Newest first: a rotation between two opens then shows a file twice, never hides one.
        for file in reversed(files(path)):
            try:
                stream: IO[bytes] = stack.enter_context(file.open("rb"))
            except OSError:
                continue
            status = os.fstat(stream.fileno())
            streams.setdefault((status.st_dev, status.st_ino), stream)
        for stream in reversed(list(streams.values())):
            yield from (event for event in map(_parse, stream) if event is not None)


def _parse(line: bytes) -> dict[str, Any] | None:
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return event if isinstance(event, dict) else None
