"""Where logs are collected from: containers of a Docker Engine, and folders of this computer."""

from __future__ import annotations

import fnmatch
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phm.facts import CannotTell
from phm.logs.log_copier import BASES, Gone, Seen
from phm.transport.docker import DockerEngine, EngineMissing

LABEL = "phm.logs"
"""A container with this label has its logs in the folder that is the label's value."""
ANSWER_S = 10.0
SLOWEST_BYTES_S = 100_000.0
"""A copy has ANSWER_S, and the time that it takes at this rate."""
MOST_CONTAINERS = 1000
MOST_FAILURES = 3
"""After this many containers that could not be looked into, the rest of an engine is left out."""
MOST_DEPTH = 6
MOST_FOLDERS = 1000
OF_ROOT = "lost+found"
"""Each ext4 file system has such a folder, which only root can read."""
_SPECIAL = 1 << 31 | 1 << 27 | 1 << 26 | 1 << 25 | 1 << 24 | 1 << 21 | 1 << 19
"""Bits of Go's FileMode for all that is not a regular file."""
_PIECE = 1 << 18


class ContainerLogs:
    """The logs in `folder` of a container. One file is one call of the engine: what a hostile container names or links in there is never
    read, and the names of the copies are ours."""

    def __init__(self, engine: DockerEngine, container: str, shown: str, folder: str) -> None:
        """container: its id. shown: its name."""
        self._engine, self._container, self._folder = engine, container, folder.rstrip("/")
        self.name = f"container {shown} at {engine.url}"

    def inspect(self, file: str) -> Seen | None:
        try:
            found = self._engine.stat_path(self._container, f"{self._folder}/{file}", deadline_s=ANSWER_S)
        except EngineMissing:
            return None
        seen, special = _seen(file, found)
        return None if special else seen

    def copy(self, file: str, sink: Callable[[bytes], object], limit: int) -> Seen:
        path = f"{self._folder}/{file}"
        expected = self.inspect(file)
        if expected is None:
            raise Gone
        deadline_s = ANSWER_S + min(expected.size, limit) / SLOWEST_BYTES_S
        try:
            size, found = self._engine.copy_with_stat(self._container, path, sink, limit=limit, deadline_s=deadline_s)
        except EngineMissing:
            raise Gone from None
        seen, _ = _seen(file, found)
        # Described at one moment, packed at the next: of a file that grew in between, only the size is known.
        return seen if seen.size == size else Seen(file, size, "")


class FolderLogs:
    """The logs in a folder of this computer: mounted, or copied from a card. Links are not followed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.name = str(folder.resolve())

    def inspect(self, file: str) -> Seen | None:
        try:
            about = os.lstat(self._folder / file)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise CannotTell(f"{self._folder / file}: {error.strerror}") from error
        return _of(file, about) if stat.S_ISREG(about.st_mode) else None

    def copy(self, file: str, sink: Callable[[bytes], object], limit: int) -> Seen:
        path = self._folder / file
        flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        try:
            handle = os.open(path, flags)
        except FileNotFoundError:
            raise Gone from None
        except OSError as error:
            raise CannotTell(f"{path}: {error.strerror}") from error
        with os.fdopen(handle, "rb", buffering=0) as stream:
            about = os.fstat(handle)
            if not stat.S_ISREG(about.st_mode) or about.st_size > limit:
                raise CannotTell(f"{path} is not a file of at most {limit} bytes")
            left = about.st_size
            while left and (piece := _read(stream, min(left, _PIECE), path)):
                sink(piece)
                left -= len(piece)
        if left:
            raise CannotTell(f"{path} became shorter")
        return _of(file, about)


def _read(stream: Any, count: int, path: Path) -> bytes:
    try:
        return bytes(stream.read(count))
    except OSError as error:  # a card that fails
        raise CannotTell(f"{path}: {error.strerror}") from error


def _of(file: str, about: os.stat_result) -> Seen:
    return Seen(file, about.st_size, str(about.st_mtime_ns))


def _seen(file: str, found: Mapping[str, Any]) -> tuple[Seen, bool]:
    """What the engine says of a file, and whether it is something else than a regular file."""
    size, mode, changed = found.get("size"), found.get("mode"), found.get("mtime")
    if not isinstance(size, int) or size < 0 or not isinstance(mode, int) or not isinstance(changed, str):
        raise CannotTell(f"the Docker Engine does not say what {file} is")
    return Seen(file, size, changed[:64]), bool(mode & _SPECIAL)


@dataclass(frozen=True)
class LogSearchResult:
    """The logs that were found in one place, and what was looked for in vain: (what, why)."""

    found: tuple[ContainerLogs | FolderLogs, ...]
    missing: tuple[tuple[str, str], ...] = ()


def of_engine(engine: DockerEngine, folder: str, patterns: Sequence[str]) -> LogSearchResult:
    """The containers with a log in `folder`, or in the one that their label names; running or not.

    patterns: only containers with such names. Raises CannotTell if the engine does not answer.
    """
    found: list[ContainerLogs | FolderLogs] = []
    missing: list[tuple[str, str]] = []
    used, failures = set[str](), 0
    wanted = list(_containers(engine, folder, patterns, used))
    others = f"the other containers at {engine.url}"
    for number, (name, container, place) in enumerate(wanted):
        if number == MOST_CONTAINERS:
            missing.append(
                (others, f"{len(wanted) - number} of {len(wanted)} were not searched: choose some with --container")
            )
            break
        logs = ContainerLogs(engine, container, name, place)
        try:
            has = any(logs.inspect(base) is not None for base in BASES)
        except CannotTell as error:
            missing.append((logs.name, str(error)))
            failures += 1
            if failures == MOST_FAILURES:
                missing.append((others, "not read, because others could not be read"))
                break
            continue
        if has:
            found.append(logs)
        elif patterns:
            missing.append((logs.name, f"has no phm.jsonl in {place}: name the folder with --path"))
    missing += [(f"container {one} at {engine.url}", "there is none") for one in patterns if one not in used]
    if not found and not missing:
        missing.append((engine.url, f"no container has {folder}/phm.jsonl: name the folder with --path"))
    return LogSearchResult(tuple(found), tuple(missing))


def _containers(
    engine: DockerEngine, folder: str, patterns: Sequence[str], used: set[str]
) -> Iterator[tuple[str, str, str]]:
    """Name, id and folder of logs. Adds to `used` which patterns fit a container."""
    for summary in engine.list(deadline_s=ANSWER_S):
        names, labels, container = summary.get("Names"), summary.get("Labels"), summary.get("Id")
        name = str(names[0]).lstrip("/") if isinstance(names, list) and names else str(container)[:12]
        fitting = {one for one in patterns if fnmatch.fnmatchcase(name, one)}
        used |= fitting
        if isinstance(container, str) and (fitting or not patterns):
            place = labels.get(LABEL) if isinstance(labels, dict) else None
            yield name, container, place if isinstance(place, str) and place.startswith("/") else folder


def of_path(path: Path, without: Path) -> LogSearchResult:
    """The folders with logs in `path`: itself, and those below it. without: the folder into which logs are collected."""
    if not path.is_dir():
        return LogSearchResult((), ((str(path), "is not a folder" if path.exists() else "does not exist"),))
    found: list[ContainerLogs | FolderLogs] = []
    missing: list[tuple[str, str]] = []

    def unreadable(error: OSError) -> None:
        if os.path.basename(error.filename) != OF_ROOT and len(missing) < MOST_FOLDERS:
            missing.append((str(error.filename), error.strerror or str(error)))

    for place, folders, names in os.walk(path, onerror=unreadable):
        if Path(place).resolve() == without.resolve():
            folders.clear()
            continue
        folders.sort()
        if len(Path(place).relative_to(path).parts) >= MOST_DEPTH:
            folders.clear()
        if len(found) >= MOST_FOLDERS:
            missing.append(
                (f"the other folders in {path}", f"not searched: {MOST_FOLDERS} folders with logs are the limit")
            )
            break
        if any(base in names or f"{base}.1" in names or f"{base}.1.gz" in names for base in BASES):
            found.append(FolderLogs(Path(place)))
    if not found and not missing:
        missing.append((str(path), f"no phm.jsonl in it, or deeper than {MOST_DEPTH} folders"))
    return LogSearchResult(tuple(found), tuple(missing))
