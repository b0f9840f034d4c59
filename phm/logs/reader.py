"""One log, read from its oldest file on and followed across rotation, in bounded memory."""

from __future__ import annotations

import gzip
import hashlib
import os
import zlib
from collections.abc import Hashable, Iterator
from pathlib import Path
from typing import IO, Any, cast

from phm.core.duplicate_filter import DuplicateFilter
from phm.wire import json_log
from phm.wire.text import one_line

MAX_LINE = 2_000_000
"""Bytes. The daemon writes at most 8000; a longer line than this is left out."""
_TRIES = 5
_REMEMBERED = 4 * json_log.MOST_FILES
_BROKEN = (OSError, EOFError, zlib.error)


class LogReader:
    """Each call of `events` gives what was added since the one before. One file is open at a time.

    path: the log file, or its directory. alone: only this file, without those that rotation made of it.
    Files are recognized by their first line, so a file that was renamed or compressed meanwhile is not read twice.
    """

    def __init__(self, path: Path, *, alone: bool = False) -> None:
        self.path = path / "phm.jsonl" if path.is_dir() else path
        self.skipped = 0
        """Number of lines that are not JSON objects, or are too long."""
        self.damaged: dict[str, str] = {}
        """Why a file could not be read to its end, by its name."""
        self.any_read = False
        """Whether there was an event in it."""
        self._alone = alone
        self._stream: IO[bytes] | None = None
        self._plain: IO[bytes] | None = None
        self._file = self.path
        self._key: Hashable = None
        self._pending = b""
        self._skipping = False
        self._seen: DuplicateFilter[Hashable, bool] = DuplicateFilter(_REMEMBERED)
        self._nothing: object = None

    def again(self) -> LogReader:
        """A reader of the same log, at its beginning."""
        return LogReader(self.path, alone=self._alone)

    def events(self, *, last: bool = False) -> Iterator[dict[str, Any]]:
        """What is there by now. last: nothing will follow, so a line without its end counts."""
        for line in self.lines(last=last):
            event = json_log.parse(line)
            if event is not None:
                self.any_read = True
                yield event
            elif line.strip(b"\0 \r\n"):
                self.skipped += 1

    def lines(self, *, last: bool = False) -> Iterator[bytes]:
        """The same as `events`, not parsed."""
        while self._stream is not None or self._open_next():
            yield from self._available()
            if self._in_place():
                break
            yield from self._available()  # written after the last read, before it was rotated
            yield from self._rest()
            self._finish()
        if last:
            yield from self._rest()

    def problems(self) -> list[str]:
        """What was not read, as sentences of one line."""
        found = [
            f"{file}: damaged or unreadable: {why}; the lines before it are shown" for file, why in self.damaged.items()
        ]
        if self.skipped:
            found.append(f"{self.path}: {self.skipped} lines are incomplete or not JSON and were left out")
        return [one_line(text) for text in found]

    def close(self) -> None:
        for stream in (self._stream, self._plain):
            if stream is not None:
                stream.close()
        self._stream = self._plain = None

    def _rest(self) -> Iterator[bytes]:
        if self._pending:
            yield self._pending
        self._pending, self._skipping = b"", False

    def _available(self) -> Iterator[bytes]:
        assert self._stream is not None
        try:
            while part := self._stream.readline(MAX_LINE + 1):
                whole = part.endswith(b"\n")
                if self._skipping:
                    self._skipping = not whole
                    continue
                self._pending += part
                if len(self._pending) > MAX_LINE:
                    self.skipped += 1
                    self._pending, self._skipping = b"", not whole
                elif whole:
                    line, self._pending = self._pending, b""
                    yield line
        except _BROKEN as error:
            self._damage(self._file, error)

    def _in_place(self) -> bool:
        """Whether more can be added to the open file."""
        if self._file != self.path or self._plain is not None or self._stream is None:
            return False
        mine = os.fstat(self._stream.fileno())
        try:
            there = os.stat(self.path)
        except OSError:
            return True  # until another one is there
        if (there.st_dev, there.st_ino) != (mine.st_dev, mine.st_ino):
            return False
        if mine.st_size < self._stream.tell():  # emptied by someone else
            self._stream.seek(0)
            self._pending, self._skipping = b"", False
        return True

    def _finish(self) -> None:
        if self._stream is not None:
            self._seen.add(self._key, True)
            try:
                self._stream.seek(0)
                self._seen.add(_key(self._stream), True)
            except _BROKEN as error:
                self._damage(self._file, error)
        self.close()

    def _open_next(self) -> bool:
        """Open the oldest file that was not read. A rotation meanwhile would change the order, so look again then."""
        for _ in range(_TRIES):
            listed = self._listed()
            if listed == self._nothing:
                return False
            if not self._open_first(listed):
                self._nothing = listed
                return False
            if self._listed() == listed:
                return True
            self.close()
        return self._open_first(self._listed())

    def _open_first(self, listed: list[tuple[Path, object]]) -> bool:
        for file, _identity in listed:
            try:
                plain = file.open("rb")
            except FileNotFoundError:  # renamed meanwhile: it is looked for again
                continue
            except OSError as error:
                self._damage(file, error)
                continue
            if file.name.endswith(json_log.COMPRESSED):
                self._plain, self._stream = plain, cast(IO[bytes], gzip.GzipFile(fileobj=plain))
            else:
                self._plain, self._stream = None, plain
            try:
                key = _key(self._stream)
            except _BROKEN as error:
                self._damage(file, error)
                key = None
            if key is not None and not self._seen.get(key):
                self._file, self._key = file, key
                return True
            self.close()
        return False

    def _listed(self) -> list[tuple[Path, object]]:
        """The files with what differs after a rotation. Pipes and directories are left out."""
        found: list[tuple[Path, object]] = []
        for file in [self.path] if self._alone else json_log.files(self.path):
            try:
                about = file.stat()
            except OSError:
                continue
            if file.is_file():
                found.append((file, (about.st_dev, about.st_ino, about.st_size == 0)))
        return found

    def _damage(self, file: Path, error: BaseException) -> None:
        if len(self.damaged) < json_log.MOST_FILES:
            self.damaged[str(file)] = getattr(error, "strerror", None) or str(error) or type(error).__name__


def _key(stream: IO[bytes]) -> Hashable:
    """A short key of a line's `json_log.identity`."""
    key = json_log.identity(stream)
    return hashlib.blake2b(key).digest() if isinstance(key, bytes) else key
