"""Delete old files from a full disk, in the folders that the configuration lists."""

from __future__ import annotations

import contextlib
import heapq
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import islice
from pathlib import PurePosixPath
from typing import ClassVar

from phm.core.model import Fault
from phm.core.settings import FreeDiskSettings
from phm.facts.disk_space import space
from phm.recovery.actions._paths import FOLDER, open_plain
from phm.recovery.base import (
    Action,
    ActionContext,
    ActionFailed,
    ActionSettings,
    Impact,
    NotNeeded,
    NotYet,
    Target,
    TargetKind,
)

ENOUGH = 0.9
"""Files are deleted until the disk is at this share of `host.disk.warn`: at the limit itself it would soon be full
again."""
MOST = 10_000
"""Maximum number of files held in memory, the oldest; a folder with more is emptied in several runs."""
MOST_SEEN = 1_000_000
"""Maximum number of names examined: about 10 s on an SD card."""
DEPTH = 8
MOST_REFUSED = 3
"""When this many files of a folder cannot be deleted, PHM does not try the others."""
LOOK_AGAIN_S = 60.0
"""While the listed files are only too recent, their ages are read this often at most: a folder may have a million of them."""


@dataclass(frozen=True, order=True)
class OldFile:
    """A file that may be deleted once it is old enough, at `path` below the configured folder.

    changed: the latest monotonic time at which the file can have changed. It orders files that changed while PHM observed
    the clock. Older files all have the same value, and are ordered by their time stamp.
    """

    changed: float
    stamp: float
    path: str
    size: int


class FreeDisk(Action):
    """Delete files that `host.free_disk` lists, oldest first, until the disk has enough space.

    Applications also write there and may replace a folder by a link. So PHM follows neither links nor mounts.
    """

    name = "free_disk"
    starts = False
    impact = Impact.NOTHING
    deadline_s = 60.0
    _waiting: ClassVar[dict[str, tuple[float, str]]] = {}
    """By disk: until when (monotonic seconds) it is waited for files to become old enough, and the words for it. Each attempt has
    a separate action object."""

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        return target.kind is TargetKind.DISK and bool(settings.host.free_disk)

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        needed_s = min(place.older_than for place in context.settings.host.free_disk)
        left_s = needed_s - (context.clock.mono() - context.clock.steps.known_since())
        if left_s <= 0:
            return self._too_recent(target, context)
        return (
            f"PHM does not know how old files are until it has observed the clock for {needed_s:.0f} s (host.free_disk, "
            f"older_than), in another {math.ceil(left_s)} s: before that, the clock may have been set"
        )

    def _too_recent(self, target: Target, context: ActionContext) -> str:
        """That all listed files are only too recent; empty: one is old enough, or there is none. They become old enough by themselves,
        so this must not count as a failed attempt: after three PHM would give up."""
        disk, now = target.key, context.clock.mono()
        until, words = self._waiting.get(disk, (now, ""))
        if now < until:
            return words
        left_s = _next_old_s(disk, context) if used_percent(disk) >= _goal(context) else None
        if not left_s:
            return ""
        return self._wait(target, min(left_s, LOOK_AGAIN_S), left_s, context)

    def _wait(self, target: Target, pause_s: float, left_s: float, context: ActionContext) -> str:
        """Wait this long before ages are read again. Returns what for; the next file is old enough in `left_s`."""
        words = (
            f"no other file that host.free_disk names is old enough (older_than), the next one in {math.ceil(left_s)} s, "
            f"unless it is changed; meanwhile {target.manual_step()}"
        )
        self._waiting[target.key] = (context.clock.mono() + pause_s, words)
        return words

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        disk, host, goal = target.key, context.settings.host, _goal(context)
        problems: list[str] = []
        removed = [old for place in host.free_disk for old in _clear(place, disk, goal, problems, context)]
        used = used_percent(disk)
        count, freed = len(removed), sum(old.size for old in removed)
        did = f"removed {count} old file{'' if count == 1 else 's'}, {freed / 1e6:.1f} MB"
        if used >= goal:
            still = f"{did}, but {disk} is still at {used:.0f} %, and the goal is below {goal:.0f} %: "
            left_s = _next_old_s(disk, context) if removed or not problems else None
            if left_s:
                raise NotYet(still + "; ".join([*problems, self._wait(target, LOOK_AGAIN_S, left_s, context)]))
            raise ActionFailed(still + ("; ".join(problems) or "nothing else that host.free_disk names is old enough"))
        said = f"{did}: {disk} is at {used:.0f} %"
        return said if removed else NotNeeded(said)


def used_percent(path: str) -> float:
    """Share of the disk in use, or of its inodes if that is larger. Raises ActionFailed."""
    try:
        fact = space(path)
    except OSError as error:
        raise ActionFailed(f"disk {path} cannot be read: {error.strerror or error}") from error
    return max(fact.used_percent, fact.inodes_used_percent)


def _goal(context: ActionContext) -> float:
    """Files are deleted until the disk is below this percentage."""
    return ENOUGH * context.settings.host.disk.warn


def _next_old_s(disk: str, context: ActionContext) -> float | None:
    """In how many seconds the next listed file is old enough; 0: one is. None: there is none."""
    next_s = None
    for place in context.settings.host.free_disk:
        with contextlib.suppress(OSError, ActionFailed), _folder(place, disk) as folder:
            for file in _files(folder, place, context):
                left_s = max(0.0, file.changed + place.older_than - context.clock.mono())
                if not left_s:
                    return 0.0
                next_s = left_s if next_s is None else min(next_s, left_s)
    return next_s


def _clear(
    place: FreeDiskSettings, disk: str, goal: float, problems: list[str], context: ActionContext
) -> Iterator[OldFile]:
    """Delete files of one folder until the goal is reached. Yields the deleted ones. Adds to `problems` why others remain."""
    refused = 0
    if used_percent(disk) < goal:
        return
    try:
        with _folder(place, disk) as folder:
            for old in heapq.nsmallest(MOST, _old_files(folder, place, context)):
                if used_percent(disk) < goal or refused >= MOST_REFUSED:
                    return
                try:
                    _unlink(folder, old.path)
                except OSError as error:
                    refused += 1
                    problems.append(f"{place.path}/{old.path}: {error.strerror or error}")
                else:
                    yield old
    except ActionFailed as error:
        problems.append(str(error))


@contextlib.contextmanager
def _folder(place: FreeDiskSettings, disk: str) -> Iterator[int]:
    """The folder, open. Raises ActionFailed if it cannot be opened or is on another disk."""
    try:
        folder = open_plain(place.path, FOLDER)
    except OSError as error:
        raise ActionFailed(f"{place.path}: {error.strerror or error}") from error
    try:
        if os.fstat(folder).st_dev != os.stat(disk).st_dev:
            raise ActionFailed(f"{place.path} is on another disk")
        yield folder
    finally:
        os.close(folder)


def _old_files(folder: int, place: FreeDiskSettings, context: ActionContext) -> Iterator[OldFile]:
    """The files that may be deleted: those that were not changed recently."""
    now = context.clock.mono()
    return (file for file in _files(folder, place, context) if now - file.changed >= place.older_than)


def _files(folder: int, place: FreeDiskSettings, context: ActionContext) -> Iterator[OldFile]:
    """The listed files, also recent ones. A clock step does not make a file old, whether or not PHM has observed the step."""
    home = os.fstat(folder).st_dev
    for path, entry in islice(_entries(folder, home), MOST_SEEN):
        if not _named(path, place.files):
            continue
        with contextlib.suppress(OSError):  # deleted meanwhile
            if entry.is_file(follow_symlinks=False):
                seen = entry.stat(follow_symlinks=False)
                changed = context.clock.latest(seen.st_mtime)
                if seen.st_dev == home:
                    yield OldFile(changed, seen.st_mtime, path, seen.st_blocks * 512)


def _named(path: str, patterns: list[str]) -> bool:
    return any(fnmatchcase(PurePosixPath(path).name, pattern) for pattern in patterns)


def _entries(folder: int, home: int, path: str = "", depth: int = DEPTH) -> Iterator[tuple[str, os.DirEntry[str]]]:
    """All names below an open folder with their relative paths, as a generator: an application may create millions.

    Links and mounts (folders that are not on the device `home`) are not entered.
    """
    with os.scandir(folder) as entries:
        for entry in entries:
            below = os.path.join(path, entry.name)
            yield below, entry
            with contextlib.suppress(OSError):  # deleted meanwhile, or PHM may not read it
                if depth and entry.is_dir(follow_symlinks=False):
                    inner = os.open(entry.name, FOLDER, dir_fd=folder)
                    try:
                        if os.fstat(inner).st_dev == home:
                            yield from _entries(inner, home, below, depth - 1)
                    finally:
                        os.close(inner)


def _unlink(folder: int, path: str) -> None:
    """Delete one file below an open folder, following no link. A file that does not exist is ignored."""
    *parents, name = PurePosixPath(path).parts
    handle = os.dup(folder)
    try:
        for parent in parents:
            inner = os.open(parent, FOLDER, dir_fd=handle)
            os.close(handle)
            handle = inner
        os.unlink(name, dir_fd=handle)
    except FileNotFoundError:
        pass
    finally:
        os.close(handle)
