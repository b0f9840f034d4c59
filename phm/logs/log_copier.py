"""Copies the files of one log from where they are written, while they are written and rotated."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from phm.facts import CannotTell
from phm.logs.copies import Fetched, key_of, merged
from phm.wire.json_log import COMPRESSED, MOST_FILES

RECORD = "phm.jsonl"
BASES = (RECORD, "phm.log")
MOST_FILE_BYTES = 2_000_000_000
MOST_BYTES = 20_000_000_000
"""Maximum number of bytes of one log that are copied in one run."""
_TRIES = 5
_HOLE = 2
"""Numbers without a file that end a log: within a rotation one name is free for a moment."""


class Gone(Exception):
    """The source has no such file."""


class _CannotWrite(CannotTell):
    """A file of this computer cannot be written."""


class _GivenUp(Exception):
    """The source no longer answers: the rest is given up."""


@dataclass(frozen=True)
class Seen:
    """A regular file of a source. changed: its time of change, in any form; empty: the size may be that of another moment."""

    name: str
    size: int
    changed: str

    @property
    def mark(self) -> str:
        """A key that is equal for the same content: a rotated file keeps its size and time under its next name."""
        return f"{self.size} {self.changed}" if self.changed else ""


class LogSource(Protocol):
    """A folder with logs, on this computer or in a container."""

    @property
    def name(self) -> str:
        """The name of the source for people; the same in each run."""

    def inspect(self, file: str) -> Seen | None:
        """A file by its name; None: no such regular file. Raises CannotTell if the source does not answer."""

    def copy(self, file: str, sink: Callable[[bytes], object], limit: int) -> Seen:
        """Pass the content of a file of at most `limit` bytes to `sink`. Raises Gone, and CannotTell with the reason; what came until
        then was passed."""


class Progress(Protocol):
    """Shows the progress of a copy."""

    def expect(self, count: int) -> None:
        """Add bytes that are still to be copied."""

    def advance(self, count: int) -> None: ...


@dataclass
class Copied:
    """What was fetched of one log. files: newest first. marks: the keys of complete files, by their marks.

    missing: (file, why). count, bytes: of what was copied. unchanged: files that are here already. any: there is such a log.
    """

    files: list[Fetched] = field(default_factory=list)
    marks: dict[str, str] = field(default_factory=dict)
    missing: list[tuple[str, str]] = field(default_factory=list)
    count: int = 0
    bytes: int = 0
    unchanged: int = 0
    any: bool = False


def fetch(source: LogSource, base: str, known: Mapping[str, str], staging: Path, progress: Progress) -> Copied:
    """Copy all files of the log `base` that are not `known` (their keys by their marks) into the folder `staging`.

    Raises CannotTell if the source does not answer at all, OSError if the copies cannot be written.
    """
    return _Fetch(source, base, known, staging, progress).run()


class _Fetch:
    def __init__(
        self, source: LogSource, base: str, known: Mapping[str, str], staging: Path, progress: Progress
    ) -> None:
        self._source, self._base, self._known, self._staging = source, base, known, staging
        self._progress = progress
        self._staged: dict[str, list[Path]] = {}
        self._failed: dict[str, str] = {}
        self._order: list[str] = []
        self._current = ""
        self._copies = 0
        self._made = Copied()

    def run(self) -> Copied:
        """Copy all files, in several turns if the log is rotated meanwhile, so that no file is missed."""
        listed = list(self._listed())
        self._made.any = bool(listed)
        try:
            for _ in range(_TRIES):
                if self._turn(listed) and self._newest() == _newest_of(listed, self._base):
                    break
                listed = list(self._listed())
            else:
                self._failed[self._base] = "it is rotated faster than it can be copied: files may be missing"
        except _GivenUp:
            pass
        except CannotTell as error:
            self._failed.setdefault(self._base, str(error))
        self._finish(listed)
        return self._made

    def _listed(self) -> Iterator[Seen]:
        """The files of the log, newest first. Files only get higher numbers, so a rotation meanwhile hides none."""
        current = self._source.inspect(self._base)
        if current is not None:
            yield current
        hole = 0
        for number in range(1, MOST_FILES + 1):
            found = self._numbered(number)
            hole = 0 if found is not None else hole + 1
            if found is not None:
                yield found
            elif hole == _HOLE:
                break

    def _numbered(self, number: int) -> Seen | None:
        name = f"{self._base}.{number}"
        if self._base != RECORD:
            return self._source.inspect(name)
        # It may be compressed between the first look and the second: then the third finds it.
        return next(filter(None, map(self._source.inspect, (name + COMPRESSED, name, name + COMPRESSED))), None)

    def _newest(self) -> str:
        found = self._numbered(1) or self._numbered(2)
        return found.mark if found is not None else ""

    def _turn(self, listed: Sequence[Seen]) -> bool:
        """Copy the files that are missing here. False: a file was renamed meanwhile."""
        have = {**self._known, **self._made.marks}
        wanted = [one for one in listed if one.size and one.mark not in have]
        self._progress.expect(sum(one.size for one in wanted))
        self._failed.clear()
        self._current = ""
        steady, order = True, list[str]()
        try:
            for one in listed:
                key = have.get(one.mark, "")
                if one in wanted and one.mark in self._made.marks:  # listed twice: renamed in between
                    key = self._made.marks[one.mark]
                elif one in wanted:
                    try:
                        key = self._copy(one)
                    except Gone:
                        steady = False
                if key:
                    order.append(key)
                    self._current = key if one.name == self._base else self._current
        finally:
            self._order = merged(order, self._order)
        return steady

    def _copy(self, one: Seen) -> str:
        """The key of the file; empty if nothing of use came. Raises Gone, _GivenUp, OSError."""
        suffix = COMPRESSED if one.name.endswith(COMPRESSED) else ""
        self._copies += 1
        path, seen, why = self._staging / f"{self._base}-{self._copies}{suffix}", Seen(one.name, 0, ""), ""
        with path.open("xb") as target:

            def put(piece: bytes) -> None:
                try:
                    target.write(piece)
                except OSError as error:
                    raise _CannotWrite(str(error)) from error
                self._progress.advance(len(piece))

            try:
                seen = self._source.copy(one.name, put, min(MOST_FILE_BYTES, MOST_BYTES - self._made.bytes))
            except _CannotWrite as error:
                raise error.__cause__ or error from None
            except CannotTell as error:
                why = str(error)
            target.flush()
            os.fsync(target.fileno())
            size = target.tell()
        self._made.bytes += size
        key = key_of(path, whole=not why)
        if key:
            self._staged.setdefault(key, []).append(path)
            self._made.count += not why
        if seen.mark and key:
            self._made.marks[seen.mark] = key
        if why:
            self._fail(one, key, f"{size} of {one.size} bytes: {why}" if size else why)
        return key

    def _fail(self, one: Seen, key: str, why: str) -> None:
        self._failed[one.name] = why
        if key:
            self._order = merged([key], self._order)
        try:
            self._source.inspect(self._base)
        except CannotTell as error:
            self._failed.setdefault("the other files", str(error))
            raise _GivenUp from None

    def _finish(self, listed: Sequence[Seen]) -> None:
        made = self._made
        made.missing = list(self._failed.items())
        made.marks |= {one.mark: self._known[one.mark] for one in listed if one.mark in self._known}
        made.unchanged = sum(one.mark in self._known for one in listed)
        for key in self._order:
            for staged in self._staged.get(key) or (None,):
                made.files.append(Fetched(key, staged, key == self._current))


def _newest_of(listed: Sequence[Seen], base: str) -> str:
    return next((one.mark for one in listed if one.name != base), "")
