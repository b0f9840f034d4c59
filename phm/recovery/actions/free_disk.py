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

from phm.core.model import Fault
from phm.core.settings import FreeDiskSettings
from phm.facts.disk_space import space
from phm.recovery.actions._paths import FOLDER, open_plain
from phm.recovery.base import Action, ActionContext, ActionFailed, ActionSettings, Impact, NotNeeded, Target, TargetKind

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


@dataclass(frozen=True, order=True)
class OldFile:
    """A file that may be deleted, at `path` below the configured folder.

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

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        return target.kind is TargetKind.DISK and bool(settings.host.free_disk)

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        needed_s = min(place.older_than for place in context.settings.host.free_disk)
        left_s = needed_s - (context.clock.mono() - context.clock.steps.known_since())
        if left_s <= 0:
            return ""
        return (
            f"PHM does not know how old files are until it has observed the clock for {needed_s:.0f} s (host.free_disk, "
            f"older_than), in another {math.ceil(left_s)} s: before that, the clock may have been set"
        )

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        disk, host = target.key, context.settings.host
        goal = ENOUGH * host.disk.warn
        problems: list[str] = []
        removed = [old for place in host.free_disk for old in _clear(place, disk, goal, problems, context)]
        used = used_percent(disk)
        count, freed = len(removed), sum(old.size for old in removed)
        did = f"removed {count} old file{'' if count == 1 else 's'}, {freed / 1e6:.1f} MB"
        if used >= goal:
            why = "; ".join(problems) or "nothing else that host.free_disk names is old enough"
            raise ActionFailed(f"{did}, but {disk} is still at {used:.0f} %, and the goal is below {goal:.0f} %: {why}")
        said = f"{did}: {disk} is at {used:.0f} %"
        return said if removed else NotNeeded(said)


def used_percent(path: str) -> float:
    """Share of the disk in use, or of its inodes if that is larger. Raises ActionFailed."""
    try:
        fact = space(path)
    except OSError as error:
        raise ActionFailed(f"disk {path} cannot be read: {error.strerror or error}") from error
    return max(fact.used_percent, fact.inodes_used_percent)


def _clear(
    place: FreeDiskSettings, disk: str, goal: float, problems: list[str], context: ActionContext
) -> Iterator[OldFile]:
    """Delete files of one folder until the goal is reached. Yields the deleted ones. Adds to `problems` why others remain."""
    refused = 0
    if used_percent(disk) < goal:
        return
    try:
        folder = open_plain(place.path, FOLDER)
    except OSError as error:
        problems.append(f"{place.path}: {error.strerror or error}")
        return
    try:
        if os.fstat(folder).st_dev != os.stat(disk).st_dev:
            problems.append(f"{place.path} is on another disk")
            return
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
    finally:
        os.close(folder)


def _old_files(folder: int, place: FreeDiskSettings, context: ActionContext) -> Iterator[OldFile]:
    """The files that may be deleted. A file that was changed recently is left out. A clock step does not make a file old,
    whether or not PHM has observed the step."""
    home = os.fstat(folder).st_dev
    for path, entry in islice(_entries(folder, home), MOST_SEEN):
        if not _named(path, place.files):
            continue
        with contextlib.suppress(OSError):  # deleted meanwhile
            if entry.is_file(follow_symlinks=False):
                seen = entry.stat(follow_symlinks=False)
                changed = context.clock.latest(seen.st_mtime)
                if seen.st_dev == home and context.clock.mono() - changed >= place.older_than:
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
