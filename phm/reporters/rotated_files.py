"""The numbered files of one log: ``path.1`` is the newest. What operators named differently is left alone."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import stat
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import IO

from phm.core import threads
from phm.wire.json_log import COMPRESSED, MOST_FILES, rotated_number

CHUNK_BYTES = 65536
LEVEL = 6
CLOSE_LIMIT_S = 2.0
LOWEST_PRIORITY = 19


class RotatedFiles(ABC):
    """Used by the thread that writes the log, with `lock` held."""

    def __init__(self, path: str) -> None:
        self._path = path
        self.lock: AbstractContextManager[object] = nullcontext()

    @abstractmethod
    def make_room(self) -> str | None:
        """Rename the older files; the free name for the newest. None: every name is taken by something that is not a file."""

    @abstractmethod
    def prune(self) -> None:
        """Remove what is beyond the limits."""

    def added(self) -> None:
        """A file was rotated, or the log was opened."""

    def close(self) -> None: ...

    def _shift(self, names: list[str]) -> None:
        """Each file takes the name of the next. Renames only: at no moment is content without a file."""
        for older, newer in zip(names[:0:-1], names[-2::-1], strict=True):
            with contextlib.suppress(FileNotFoundError):
                os.replace(newer, older)

    def _listed(self) -> Iterator[str]:
        """The rotated files, as paths. A directory or a link with such a name is none."""
        directory, base = os.path.split(self._path)
        for name in os.listdir(directory):
            path = os.path.join(directory, name)
            if rotated_number(base, name) is not None and os.path.isfile(path) and not os.path.islink(path):
                yield path


class PlainFiles(RotatedFiles):
    """A number of files, as they were written."""

    def __init__(self, path: str, files: int) -> None:
        super().__init__(path)
        self._files = files

    def make_room(self) -> str | None:
        names = [name for number in range(1, self._files + 1) if is_free_or_file(name := f"{self._path}.{number}")]
        if not names:
            return None
        self._shift(names)
        return names[0]

    def prune(self) -> None:
        base = os.path.basename(self._path)
        for path in self._listed():
            if (rotated_number(base, os.path.basename(path)) or 0) > self._files and not path.endswith(COMPRESSED):
                _remove(path)


class CompressedFiles(RotatedFiles):
    """As many files as fit into `max_bytes`. A separate thread compresses them, so that the log never waits for that.

    A file is replaced by its compressed copy only when that is complete and on the disk; after a crash in between both are there, with
    the same content, or the copy has a temporary name.
    """

    def __init__(self, path: str, max_bytes: int) -> None:
        super().__init__(path)
        self._max_bytes, self.lock = max_bytes, threading.Lock()
        self._temporary = f"{path}{COMPRESSED}.{os.getpid()}.tmp"
        self._wake, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-log-gzip", daemon=True)
        self._started = False

    def make_room(self) -> str | None:
        numbers: list[int] = []
        for number in range(1, MOST_FILES + 1):
            names = (f"{self._path}.{number}", f"{self._path}.{number}{COMPRESSED}")
            if not all(is_free_or_file(name) for name in names):
                continue
            numbers.append(number)
            if not any(os.path.lexists(name) for name in names):
                break
        if not numbers:
            return None
        self._drop_duplicates()
        # Number by number: were the uncompressed files moved first, SIGKILL in between would leave two different files with
        # the same number, and the compressed copy of one would replace the other.
        for older, newer in zip(numbers[:0:-1], numbers[-2::-1], strict=True):
            for suffix in ("", COMPRESSED):
                self._shift([f"{self._path}.{number}{suffix}" for number in (newer, older)])
        return f"{self._path}.{numbers[0]}"

    def prune(self) -> None:
        total = 0
        for path in self._newest_first():
            with contextlib.suppress(FileNotFoundError):
                total += os.stat(path).st_size
                if total > self._max_bytes:
                    _remove(path)

    def added(self) -> None:
        if not self._started and any(not path.endswith(COMPRESSED) for path in self._listed()):
            self._started = True
            threads.start(self._thread)
        self._wake.set()

    def close(self) -> None:
        """An unfinished copy is discarded; the next run compresses the file."""
        self._stop.set()
        self._wake.set()
        threads.join(self._thread, CLOSE_LIMIT_S)

    def _newest_first(self) -> list[str]:
        base = os.path.basename(self._path)
        return sorted(self._listed(), key=lambda path: (rotated_number(base, os.path.basename(path)) or 0, path))

    # ------------------------------------------------------------ the thread that compresses

    def _loop(self) -> None:
        if sys.platform == "linux":
            with contextlib.suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOWEST_PRIORITY)
        self._remove_unfinished()
        while not self._stop.is_set():
            self._wake.clear()
            try:
                self._remove_duplicates()
                for path in reversed(self._newest_first()):
                    if not path.endswith(COMPRESSED):
                        self._compress(path)
            except OSError:  # a full disk, a file that is gone: the file remains unchanged, and is tried again after the next rotation
                _remove(self._temporary)
            self._wake.wait()

    def _remove_unfinished(self) -> None:
        """Remove the unfinished copies of an earlier run."""
        directory, base = os.path.split(self._path)
        unfinished = re.compile(rf"{re.escape(base + COMPRESSED)}\.[0-9]+\.tmp")
        for name in os.listdir(directory):
            if unfinished.fullmatch(name):
                _remove(os.path.join(directory, name))

    def _remove_duplicates(self) -> None:
        with self.lock:
            self._drop_duplicates()

    def _drop_duplicates(self) -> None:
        """After a crash: a file and its complete copy."""
        for path in self._newest_first():
            if os.path.lexists(path + COMPRESSED):
                _remove(path)

    def _compress(self, path: str) -> None:
        with open(path, "rb") as source:
            about = os.fstat(source.fileno())
            if not stat.S_ISREG(about.st_mode):
                return
            with open(self._temporary, "wb") as target:
                complete = self._copy(source, target)
            if not complete:
                _remove(self._temporary)
                return
            with self.lock:  # it may have got another number meanwhile, or have been removed
                now = next((name for name in self._newest_first() if _same(name, about)), None)
                if now is None:
                    _remove(self._temporary)
                    return
                os.replace(self._temporary, now + COMPRESSED)
                if sys.platform != "win32":  # there, not while it is open: the next turn removes it
                    _remove(now)

    def _copy(self, source: IO[bytes], target: IO[bytes]) -> bool:
        """Copy a file; return False if it was stopped."""
        with gzip.GzipFile("", "wb", LEVEL, target, mtime=0) as packed:
            while chunk := source.read(CHUNK_BYTES):
                if self._stop.is_set():
                    return False
                packed.write(chunk)
        target.flush()
        os.fsync(target.fileno())
        return True


def is_free_or_file(path: str) -> bool:
    """Whether rotation may put a file there: the name is free, or of a regular file. Raises OSError."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except FileNotFoundError:
        return True


def _same(path: str, about: os.stat_result) -> bool:
    try:
        found = os.stat(path)
    except OSError:
        return False
    return (found.st_dev, found.st_ino) == (about.st_dev, about.st_ino)


def _remove(path: str) -> None:
    with contextlib.suppress(OSError):  # a file that cannot be removed must not stop the log
        if is_free_or_file(path):
            os.unlink(path)
