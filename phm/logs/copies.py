"""Copies of one log, in a folder and under the names that rotation would give them, so that every reader of logs can read them.

At its source a file is renamed at each rotation, compressed, and in the end removed. Here nothing is removed: what the source no longer
has keeps its place behind the newer files. Files are recognized by their first line, as everywhere in PHM.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from phm.wire import json_log
from phm.wire.json_log import COMPRESSED, MAX_LINE, MOST_FILES

OLDER = "older"
"""``older-1``, ``older-2`` ...: folders with what has no number any more, of MOST_FILES files of each log."""
MOST_TEXT_BYTES = 4_000_000_000
"""Of a file, not compressed, that is compared with another one: a hostile file may have any size."""
_CHUNK = 1 << 20
BROKEN = (OSError, EOFError, zlib.error)


@dataclass(frozen=True)
class Fetched:
    """A file of the source. key: see `key_of`. staged: its new copy; None: the present one is up to date."""

    key: str
    staged: Path | None
    current: bool
    """Whether it is the file that is being written, without a number."""


def key_of(path: Path, *, whole: bool = True) -> str:
    """Equal for a file, its longer version and its compressed copy; empty for an empty file. Raises OSError.

    whole: False for the beginning of a file; empty, if not even its first line is complete.
    """
    with path.open("rb") as plain:
        try:
            first = text_of(plain, path).readline(MAX_LINE)
            if not whole and not first.endswith(b"\n"):
                return ""
        except BROKEN:  # damaged within its first line
            if not whole:
                return ""
            plain.seek(0)
            first = plain.read(_CHUNK)
    return hashlib.blake2b(first, digest_size=16).hexdigest() if first else ""


def covers(new: Path, old: Path) -> bool:
    """Whether `new` begins with all that can be read of `old`, and can be read to its end."""
    left = MOST_TEXT_BYTES
    try:
        with new.open("rb") as plain, old.open("rb") as plain_old:
            fresh, had = text_of(plain, new), text_of(plain_old, old)
            while left > 0 and (piece := _readable(had)):
                left -= len(piece)
                if fresh.read(len(piece)) != piece:
                    return False
            while left > 0 and (piece := fresh.read(_CHUNK)):
                left -= len(piece)
    except BROKEN:
        return False
    return left > 0


def merged(newer: Sequence[str], older: Sequence[str]) -> list[str]:
    """Two orders, newest first, as one. What only `older` has stays directly before what it was before."""
    made = list(newer)
    for place in reversed(range(len(older))):
        key = older[place]
        if key not in made:
            after = next((each for each in older[place + 1 :] if each in made), None)
            made.insert(len(made) if after is None else made.index(after), key)
    return made


class Copies:
    """The copies of the log `base` (``phm.jsonl`` or ``phm.log``) in `folder`; the folder need not exist."""

    def __init__(self, folder: Path, base: str) -> None:
        self.folder, self.base = folder, base
        self._moving = re.compile(rf"\.{re.escape(base)}\.([0-9]{{3}})\.[0-9a-f]+\.moving(?:\.gz)?")

    def keys(self) -> set[str]:
        """Of all files, also those in the folders `older-1` .... Raises OSError."""
        found = {key_of(path) for path in self._files(self.folder)}
        for folder in self._older():
            found |= {key_of(path) for path in self._files(folder)}
        return found - {""}

    def take(self, fetched: Sequence[Fetched]) -> None:
        """Put what was fetched (the order of the source, newest first) into place; staged files are moved. Raises OSError."""
        self.folder.mkdir(parents=True, exist_ok=True)
        present, dropped = self._present()
        aside = {key_of(path): path for folder in self._older() for path in self._files(folder)}
        before, order, current = list(present), list[str](), ""
        for each in fetched:
            key = each.key
            if each.staged is not None and key in aside and covers(aside[key], each.staged):
                dropped.append(each.staged)
                continue
            if each.staged is not None:
                key = _choose(key, each.staged, present, dropped)
            if key in present:
                order.append(key)
                current = key if each.current else current
        keep = set(order)
        order = merged(list(dict.fromkeys(order)), before)
        if not current and order and order[0] not in keep and present[order[0]].name == self.base:
            current = order[0]  # the source has none, or it could not be copied
        if current and not present[current].name.endswith(COMPRESSED):
            order.remove(current)
            order.insert(0, current)
        else:
            current = ""
        if len(order) - bool(current) > MOST_FILES:
            self._put_aside([present[key] for key in order if key not in keep and key != current])
            order = [key for key in order if key in keep or key == current]
        _arrange(self.folder, self.base, [present[key] for key in order], dropped, first=0 if current else 1)

    def _present(self) -> tuple[dict[str, Path], list[Path]]:
        """What is there, newest first, and what of it another file covers: a run was interrupted."""
        present: dict[str, Path] = {}
        dropped: list[Path] = []
        for path in self._files(self.folder):
            _choose(key_of(path) or path.name, path, present, dropped)
        return present, dropped

    def _put_aside(self, files: Sequence[Path]) -> None:
        """Into the newest folder of older files, or the next one when that is full."""
        if not files:
            return
        folders = self._older()
        there = self._files(folders[-1]) if folders else []
        if not folders or len(there) + len(files) > MOST_FILES:
            folders.append(self.folder / f"{OLDER}-{len(folders) + 1}")
            there = []
        folders[-1].mkdir(exist_ok=True)
        _arrange(folders[-1], self.base, [*files, *there], [], first=1)

    def _older(self) -> list[Path]:
        found: list[Path] = []
        while (folder := self.folder / f"{OLDER}-{len(found) + 1}").is_dir():
            found.append(folder)
        return found

    def _files(self, folder: Path) -> list[Path]:
        """Newest first. What an interrupted run was moving is there as well."""
        numbered: list[tuple[int, str, Path]] = []
        for path in folder.iterdir() if folder.is_dir() else ():
            moving = self._moving.fullmatch(path.name)
            number = int(moving[1]) if moving else 0 if path.name == self.base else _number(self.base, path.name)
            if number is not None and path.is_file() and not path.is_symlink():
                numbered.append((number, path.name, path))
        return [path for _, _, path in sorted(numbered)]


def _choose(key: str, new: Path, present: dict[str, Path], dropped: list[Path]) -> str:
    """Add `new`; of two versions of a file keep the one that has all, or both, if neither has. Returns the key in `present`."""
    versions = [each for each in present if each.partition(" ")[0] == key]
    for each in versions:
        if covers(new, present[each]):
            dropped.append(present[each])
            present[each] = new
            return each
        if covers(present[each], new):
            dropped.append(new)
            return each
    made = f"{key} {len(versions)}" if versions else key
    present[made] = new
    return made


def _number(base: str, name: str) -> int | None:
    digits = name.removesuffix(COMPRESSED).removeprefix(f"{base}.")
    found = json_log.rotated_number(base, name)
    return found if found is not None else int(digits) if re.fullmatch("[1-9][0-9]{2}", digits) else None


def _arrange(folder: Path, base: str, files: Sequence[Path], dropped: Sequence[Path], *, first: int) -> None:
    """Give the files their numbers, from `first` (0: no number) on. At no moment has content no file, and each name that an
    interruption leaves is found again by the next run."""
    moves, token = [], os.urandom(4).hex()  # names of an earlier run may still be there
    for number, path in enumerate(files, first):
        suffix = COMPRESSED if path.name.endswith(COMPRESSED) else ""
        target = folder / f"{base}{f'.{number}' if number else ''}{suffix}"
        if path != target:
            moves.append((path, folder / f".{base}.{number:03}.{token}.moving{suffix}", target))
    for path, moving, _ in moves:
        os.replace(path, moving)
    for path in dropped:
        path.unlink(missing_ok=True)
    for _, moving, target in moves:
        os.replace(moving, target)


def text_of(plain: IO[bytes], path: Path) -> IO[bytes]:
    """The content of the opened file at `path`, not compressed. Reading raises BROKEN."""
    return cast(IO[bytes], gzip.GzipFile(fileobj=plain)) if path.name.endswith(COMPRESSED) else plain


def _readable(stream: IO[bytes]) -> bytes:
    """The next piece; empty at the end, and where the file is damaged."""
    try:
        return stream.read(_CHUNK)
    except BROKEN:
        return b""
