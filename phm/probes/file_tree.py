"""Checksums of all files in a folder, at bounded cost. Part of `phm.probes.files`.

What a hostile program can do to the folder while it is read leads nowhere: each folder is opened relative to its parent and
without following links, only regular files are opened, and number, depth, bytes and time are limited. The checksum of a file
is calculated again only if its size, times or inode have changed.
"""

from __future__ import annotations

import hashlib
import os
import stat
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from phm.core.clock import Clock
from phm.facts import CannotTell
from phm.probes.file_stamp import Stamp, settled, stamp
from phm.wire.manifest import MAX_FILES

MAX_DEPTH = 64
MAX_ENTRIES = 2 * MAX_FILES
"""Names that are read in one walk, with those that are ignored: all of a folder are in memory together."""
MAX_PATHS = 8 << 20
"""Characters of the relative paths of all files together, which stay in memory: 160 for each of MAX_FILES."""
SCAN_BYTES = 64 << 20
"""Read in one scan; the rest of a large folder follows in the next scans."""
SCAN_S = 1.5
WALK_S = 10.0
"""For finding the files, without reading them."""
FILE_S = 10.0
"""For reading one file; the rest of a large one follows in the next scans."""
BUSY_S = 5.0
"""This long a scan waits for another one at the same folder. Well below the deadline of the check."""
SHARE = 20
"""A walk is repeated after this many times its duration at the earliest, so that it takes at most 5 % of a core."""
_PIECE = 1 << 20
_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_FILE = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


@dataclass(slots=True)
class TreeListing:
    """Files and links of a folder, by relative path. sums: those that have been read. pending: those that were not read yet."""

    sums: dict[str, str] = field(default_factory=dict)
    pending: set[str] = field(default_factory=set)
    unreadable: set[str] = field(default_factory=set)
    size: int = 0
    """Bytes of all files together."""
    part: int = 0
    """Bytes that were read of large files so far."""


@dataclass(slots=True)
class _Part:
    """What was read of a large file."""

    key: Stamp
    size: int = 0
    total: hashlib._Hash = field(default_factory=hashlib.sha256)


class TreeReader:
    """Reads one folder repeatedly. Thread-safe."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._known: dict[str, tuple[Stamp, str]] = {}
        self._parts: dict[str, _Part] = {}
        self._waiting: tuple[str, ...] = ()
        self._listing = TreeListing()
        self._problem = ""
        """Why the last walk failed, or empty."""
        self._next_s = float("-inf")

    def read(
        self,
        folder: int,
        ignore: Sequence[str],
        mounts: Mapping[str, int | None] | None = None,
        *,
        fresh: bool = False,
        partly: bool = False,
    ) -> TreeListing:
        """folder: its descriptor, which may be O_PATH. fresh: walk now, whatever it costs.

        mounts: descriptors of what is read in place of these relative paths, because it is mounted there; None if PHM
        does not see it. Raises CannotTell if the folder has one of those, has too many files, is too slow or cannot be
        read, or if another thread is still reading it after BUSY_S. partly: a mount that PHM does not see is only
        unreadable.
        """
        if not self._lock.acquire(timeout=BUSY_S):
            raise CannotTell("an earlier run is still reading it: check that its disk or network volume answers")
        try:
            if fresh or self._clock.mono() >= self._next_s:
                self._scan(folder, ignore, mounts or {}, partly=partly)
            if self._problem:
                raise CannotTell(self._problem)
            return self._listing
        finally:
            self._lock.release()

    def _scan(self, folder: int, ignore: Sequence[str], mounts: Mapping[str, int | None], *, partly: bool) -> None:
        """A failure is remembered like a listing: a walk that fails costs as much as one that does not."""
        began_s = self._clock.mono()
        walk = _Walk(self._clock, ignore, mounts, self._known, self._parts, self._waiting, partly=partly)
        self._problem = "the previous run did not finish reading it"
        try:
            walk.run(folder)
            self._known, self._parts, self._waiting, self._problem = walk.found, walk.parts, walk.waiting, ""
            if walk.listing != self._listing:  # otherwise the same object, with which nothing must be compared again
                self._listing = walk.listing
        except CannotTell as reason:
            self._problem = str(reason)
        except OSError as error:
            self._problem = f"it cannot be read: {error.strerror}"
        finally:
            ended_s = self._clock.mono()
            times = 2 if walk.listing.pending and not self._problem else SHARE
            self._next_s = ended_s + (ended_s - began_s) * times


class _Descriptor:
    def __init__(self, number: int) -> None:
        self.number = number

    def close(self) -> None:
        os.close(self.number)


class _Walk:
    """One scan: finds all files, then reads those that have changed, within the limits of one scan.

    waiting: files that the last scan did not get to, longest wait first. They come first, so that a large file that changes
    all the time does not keep the others from being read.
    """

    def __init__(
        self,
        clock: Clock,
        ignore: Sequence[str],
        mounts: Mapping[str, int | None],
        known: dict[str, tuple[Stamp, str]],
        parts: dict[str, _Part],
        waiting: Sequence[str],
        *,
        partly: bool,
    ) -> None:
        self._clock, self._ignore, self._mounts = clock, tuple(ignore), mounts
        self._known, self._parts, self._partly = known, parts, partly
        self._began_s = clock.mono()
        self._entries, self._path_chars, self._bytes = 0, 0, 0
        self._changed: set[str] = set()
        self.waiting = tuple(waiting)
        self.found: dict[str, tuple[Stamp, str]] = {}
        self.parts: dict[str, _Part] = {}
        self.listing = TreeListing()

    def run(self, folder: int) -> None:
        """Raises CannotTell or OSError if the files cannot be found; a file that cannot be read is in the listing."""
        flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
        with closing(_Descriptor(os.open(f"/proc/self/fd/{folder}", flags))) as top:
            self._folder(top.number, "", 0)
            self._read_changed(top.number)

    # ------------------------------------------------------------ finding

    def _folder(self, number: int, path: str, depth: int) -> None:
        for name in self._names(number):
            self._in_time()
            below = f"{path}/{name}" if path else name
            self._path_chars += len(below)
            if self._path_chars > MAX_PATHS:
                raise CannotTell(
                    "the names of its files and folders are too long: choose a folder below it, or add `ignore`"
                )
            if any(fnmatchcase(name, pattern) or fnmatchcase(below, pattern) for pattern in self._ignore):
                continue
            try:
                self._entry(number, name, below, depth)
            except FileNotFoundError:
                continue  # removed meanwhile
            except OSError:
                self.listing.unreadable.add(below)

    def _names(self, number: int) -> list[str]:
        names: list[str] = []
        with os.scandir(number) as entries:
            for entry in entries:
                self._in_time()
                self._entries += 1
                if self._entries > MAX_ENTRIES:
                    raise CannotTell(
                        f"it has more than {MAX_ENTRIES} files and folders, with those that are ignored: "
                        "choose a folder below it, or remove some"
                    )
                names.append(entry.name)
        return sorted(names)

    def _entry(self, number: int, name: str, path: str, depth: int) -> None:
        info = self._status(number, name, path)
        if stat.S_ISDIR(info.st_mode):
            if depth >= MAX_DEPTH:
                raise CannotTell(f"{path[:80]}... is more than {MAX_DEPTH} folders deep")
            with closing(self._open(number, name, path, _FOLDER)) as below:
                self._folder(below.number, path, depth + 1)
        elif stat.S_ISLNK(info.st_mode):
            target = os.fsencode(os.readlink(name, dir_fd=number))
            self._add(path, stamp(info), hashlib.sha256(b"link " + target).hexdigest())
        elif stat.S_ISREG(info.st_mode):
            self._file(path, info)
        if len(self.listing.sums) + len(self._changed) > MAX_FILES:
            raise CannotTell(f"it has more than {MAX_FILES} files: choose a folder below it, or add `ignore`")

    def _status(self, number: int, name: str, path: str) -> os.stat_result:
        if path not in self._mounts:
            return os.stat(name, dir_fd=number, follow_symlinks=False)
        mounted = self._mounts[path]
        if mounted is None and self._partly:
            raise OSError(f"{path} is covered by a mount")
        if mounted is None:
            raise CannotTell(
                f"another mount covers {path} in it, which PHM does not see: mount that for PHM, too, or add it to `ignore`"
            )
        return os.fstat(mounted)

    def _open(self, number: int, name: str, path: str, flags: int) -> _Descriptor:
        mounted = self._mounts.get(path)
        if mounted is None:
            return _Descriptor(os.open(name, flags, dir_fd=number))
        return _Descriptor(os.open(f"/proc/self/fd/{mounted}", flags & ~os.O_NOFOLLOW))

    def _file(self, path: str, info: os.stat_result) -> None:
        known = self._known.get(path)
        self.listing.size += info.st_size
        if known is not None and known[0] == stamp(info):
            self._add(path, *known)
        else:
            self._changed.add(path)

    def _in_time(self) -> None:
        if self._clock.mono() - self._began_s > WALK_S:
            raise CannotTell(
                f"its files cannot be listed within {WALK_S:g} s: choose a folder below it, or add `ignore`"
            )

    # ------------------------------------------------------------ reading

    def _read_changed(self, top: int) -> None:
        first = [path for path in self.waiting if path in self._changed]
        queue = deque([*first, *sorted(self._changed.difference(first))])
        until_s = self._clock.mono() + SCAN_S
        while queue and self._bytes < SCAN_BYTES and self._clock.mono() < until_s:
            self._try(top, queue.popleft())
        self.waiting = tuple(queue)
        self.listing.pending.update(queue)
        self.parts.update({path: self._parts[path] for path in queue if path in self._parts})
        self.listing.part = sum(part.size for part in self.parts.values())

    def _try(self, top: int, path: str) -> None:
        """Open each folder on the way again without following links: it may have been replaced since it was listed."""
        *folders, name = path.split("/")
        try:
            with ExitStack() as opened:
                number, place = top, ""
                for folder in folders:
                    place = f"{place}/{folder}" if place else folder
                    below = self._open(number, folder, place, _FOLDER)
                    number = opened.enter_context(closing(below)).number
                file = opened.enter_context(closing(self._open(number, name, path, _FILE)))
                self._read(file.number, path)
        except FileNotFoundError:
            return  # removed meanwhile
        except OSError:
            self.listing.unreadable.add(path)

    def _read(self, number: int, path: str) -> None:
        before = os.fstat(number)
        key, lasts = stamp(before), settled(before)
        if not stat.S_ISREG(before.st_mode):
            return  # replaced meanwhile
        part, until_s = self._parts.get(path), self._clock.mono() + FILE_S
        continues = lasts and (part is None or part.key == key)
        if part is None or part.key != key:
            part = _Part(key)
        os.lseek(number, part.size, os.SEEK_SET)
        while piece := os.read(number, _PIECE):
            part.total.update(piece)
            part.size += len(piece)
            self._bytes += len(piece)
            # At exactly its size the next read ends it, unless it grows.
            if self._clock.mono() > until_s and part.size != before.st_size:
                # One that is written all the time is named and not read ten times as often: no scan would complete it.
                (self.listing.pending if continues else self.listing.unreadable).add(path)
                if lasts and part.size < before.st_size:
                    self.parts[path] = part
                return
        if stamp(os.fstat(number)) != key:
            self.listing.pending.add(path)  # written to while it was read
        elif lasts:
            self._add(path, key, part.total.hexdigest())
        else:
            self.listing.sums[path] = part.total.hexdigest()

    def _add(self, path: str, key: Stamp, total: str) -> None:
        self.listing.sums[path] = total
        self.found[path] = (key, total)
