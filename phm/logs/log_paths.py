"""Finds the logs that a path names."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from phm.logs.reader import LogReader
from phm.wire import json_log

MOST_LOGS = 256
MOST_DEPTH = 6
_NAME = re.compile(r"(.+\.jsonl)(?:\.[1-9][0-9]{0,2})?(?:\.gz)?")


class NoLog(Exception):
    """There is no log; the message says where it was looked for, and what to do."""


def readers(paths: Sequence[Path], *, awaited: bool = False) -> list[LogReader]:
    """A reader for each log. A path is a log file, its directory, or a folder with the logs of several agents in subfolders.

    awaited: a log that does not exist yet is not an error. Raises NoLog.
    """
    found: dict[Path, LogReader] = {}
    for path in paths:
        for log, alone in _logs(path, awaited):
            found.setdefault(log, LogReader(log, alone=alone))
            if len(found) > MOST_LOGS:
                raise NoLog(f"more than {MOST_LOGS} logs in {path}: name a smaller folder")
    return list(found.values())


def _logs(path: Path, awaited: bool) -> list[tuple[Path, bool]]:
    if path.is_file():
        return [(path, not path.name.endswith(".jsonl"))]
    if json_log.files(path):
        return [(path / "phm.jsonl" if path.is_dir() else path, False)]
    below = _below(path) if path.is_dir() else []
    if not below and not awaited:
        what = f"no phm.jsonl in {path}" if path.is_dir() else f"{path} does not exist"
        raise NoLog(f"{what}: PHM has not run here, or logs elsewhere: name the log or its directory")
    return [(log, False) for log in below] or [(path if path.suffix == ".jsonl" else path / "phm.jsonl", False)]


def _below(folder: Path) -> list[Path]:
    """The logs in the subfolders, by their name without the number of rotation. Links are not followed."""
    found: set[Path] = set()
    for place, folders, names in os.walk(folder):
        folders.sort()
        if len(Path(place).relative_to(folder).parts) >= MOST_DEPTH:
            folders.clear()
        for name in names:
            match = _NAME.fullmatch(name)
            if match is not None and not Path(place, name).is_symlink():
                found.add(Path(place, match[1]))
        if len(found) > MOST_LOGS:
            break
    return sorted(found)
