"""Checksums of all files in a folder, at bounded cost. Part of `phm.probes.files`.

What a hostile program can do to the folder while it is read leads nowhere: each folder is opened relative to its parent and
without following links, only regular files are opened, and number, depth, bytes and time are limited. The checksum of a file
is calculated again only if its size, times or inode have changed.
"""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from phm.core.clock import Clock
from phm.facts import CannotTell
from phm.wire.manifest import MAX_FILES

MAX_DEPTH = 64
LOOK_BYTES = 64 << 20
"""Read in one look; the rest of a large folder follows in the next looks."""
LOOK_S = 1.5
WALK_S = 10.0
"""For finding the files, without reading them."""
SHARE = 20
"""A walk is repeated after this many times its duration at the earliest, so that it takes at most 5 % of a core."""
_PIECE = 1 << 20
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
_Key = tuple[int, int, int, int, int]


@dataclass(slots=True)
class TreeListing:
    """Files and links of a folder, by relative path. sums: those that have been read. pending: those that were not read yet."""

    sums: dict[str, str] = field(default_factory=dict)
    pending: set[str] = field(default_factory=set)
    unreadable: set[str] = field(default_factory=set)
    size: int = 0
    """Bytes of all files together."""


class TreeReader:
    """Reads one folder repeatedly. Not thread-safe."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._known: dict[str, tuple[_Key, str]] = {}
        self._listing: TreeListing | None = None
        self._next_s = float("-inf")

    def read(self, folder: int, ignore: Sequence[str], *, fresh: bool = False) -> TreeListing:
        """folder: its descriptor, which may be O_PATH. fresh: walk now, whatever it costs.

        Raises CannotTell if the folder has too many files or is too slow.
        """
        now = self._clock.mono()
        if self._listing is not None and now < self._next_s and not fresh:
            return self._listing
        walk = _Walk(self._clock, ignore, self._known)
        with closing(
            _Descriptor(os.open(f"/proc/self/fd/{folder}", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC))
        ) as top:
            walk.folder(top.number, "", 0)
        self._known, self._listing = walk.found, walk.listing
        took_s = self._clock.mono() - now
        self._next_s = now + took_s * (2 if walk.listing.pending else SHARE)
        return walk.listing


class _Descriptor:
    def __init__(self, number: int) -> None:
        self.number = number

    def close(self) -> None:
        os.close(self.number)


class _Walk:
    def __init__(self, clock: Clock, ignore: Sequence[str], known: dict[str, tuple[_Key, str]]) -> None:
        self._clock, self._ignore, self._known = clock, tuple(ignore), known
        self._began_s = clock.mono()
        self._reading_s, self._bytes = 0.0, 0
        self.found: dict[str, tuple[_Key, str]] = {}
        self.listing = TreeListing()

    def folder(self, number: int, path: str, depth: int) -> None:
        with os.scandir(number) as entries:
            listed = sorted(entries, key=lambda entry: entry.name)
        for entry in listed:
            self._in_time()
            below = f"{path}/{entry.name}" if path else entry.name
            if any(fnmatchcase(entry.name, pattern) or fnmatchcase(below, pattern) for pattern in self._ignore):
                continue
            try:
                self._entry(number, entry.name, below, depth)
            except FileNotFoundError:
                continue  # removed meanwhile
            except OSError:
                self.listing.unreadable.add(below)

    def _entry(self, number: int, name: str, path: str, depth: int) -> None:
        info = os.stat(name, dir_fd=number, follow_symlinks=False)
        if stat.S_ISDIR(info.st_mode):
            if depth >= MAX_DEPTH:
                raise CannotTell(f"{path[:80]}... is more than {MAX_DEPTH} folders deep")
            with closing(_Descriptor(os.open(name, _FOLDER, dir_fd=number))) as below:
                self.folder(below.number, path, depth + 1)
        elif stat.S_ISLNK(info.st_mode):
            target = os.fsencode(os.readlink(name, dir_fd=number))
            self._add(path, _key(info), hashlib.sha256(b"link " + target).hexdigest())
        elif stat.S_ISREG(info.st_mode):
            self._file(number, name, path, info)

    def _file(self, number: int, name: str, path: str, info: os.stat_result) -> None:
        known = self._known.get(path)
        self.listing.size += info.st_size
        if known is not None and known[0] == _key(info):
            self._add(path, *known)
        elif self._bytes >= LOOK_BYTES or self._reading_s >= LOOK_S:
            self._pending(path)
        else:
            began_s = self._clock.mono()
            with closing(_Descriptor(os.open(name, _FILE, dir_fd=number))) as file:
                self._read(file.number, path)
            self._reading_s += self._clock.mono() - began_s

    def _read(self, number: int, path: str) -> None:
        before = os.fstat(number)
        if not stat.S_ISREG(before.st_mode):
            return  # replaced meanwhile
        total, until_s = hashlib.sha256(), self._clock.mono() + WALK_S
        while piece := os.read(number, _PIECE):
            total.update(piece)
            self._bytes += len(piece)
            if self._clock.mono() > until_s:
                raise OSError(f"{path} is too slow to read")
        if _key(os.fstat(number)) != _key(before):
            self._pending(path)  # written to while it was read
        else:
            self._add(path, _key(before), total.hexdigest())

    def _add(self, path: str, key: _Key, total: str) -> None:
        self.listing.sums[path] = total
        self.found[path] = (key, total)
        self._count()

    def _pending(self, path: str) -> None:
        self.listing.pending.add(path)
        self._count()

    def _count(self) -> None:
        if len(self.listing.sums) + len(self.listing.pending) > MAX_FILES:
            raise CannotTell(f"it has more than {MAX_FILES} files: choose a folder below it, or add `ignore`")

    def _in_time(self) -> None:
        if self._clock.mono() - self._began_s - self._reading_s > WALK_S:
            raise CannotTell(
                f"its files cannot be listed within {WALK_S:g} s: choose a folder below it, or add `ignore`"
            )


def _key(info: os.stat_result) -> _Key:
    return info.st_dev, info.st_ino, info.st_size, info.st_mtime_ns, info.st_ctime_ns
