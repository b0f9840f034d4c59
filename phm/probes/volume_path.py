"""Walks a path of a container through the mounts that PHM sees, and never leaves them.

A program that writes into the volume may be broken or hostile. So each component is opened relative to the previous one
without following links, and a link that is swapped in meanwhile leads nowhere. This module resolves links itself, in
the container's own path space.
"""

from __future__ import annotations

import errno
import os
import stat
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

MAX_LINKS = 40  # the kernel's limit
_OPEN = os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC
_MISSING = (errno.ENOENT, errno.ENOTDIR, errno.ELOOP, errno.ENAMETOOLONG)


class OutsideVolumes(Exception):
    """The path, or its target, is not visible through a volume: ask the engine."""


def normal(path: str) -> str:
    """Absolute, without empty components or dots; `..` stays, because it may follow a link."""
    return "/" + "/".join(part for part in path.split("/") if part not in ("", "."))


def join(directory: str, path: str) -> str:
    """`path` relative to `directory`, normalised as text."""
    return os.path.normpath(os.path.join(directory, path))


Passing = Callable[[int, str], None]
"""Called with each step: the directory's open descriptor, and the name that is looked up in it."""


class SeenAt(NamedTuple):
    """Where PHM sees a mount: at the root of one of its own mounts, or at `rest` below it, which programs may replace by links."""

    mount: str
    rest: str = ""


def resolve(path: str, roots: Mapping[str, SeenAt | None], passing: Passing | None = None) -> int | None:
    """A descriptor (O_PATH, to be closed) of the target of `path`, or None if it does not exist.

    roots: destination of every mount of the container -> where PHM sees it, None if it does not. Raises Outside if the
    path leads out of these.
    """
    with _Walk(roots, passing) as walk:
        try:
            return walk.to(path)
        except OSError as error:
            if error.errno in _MISSING:
                return None
            raise OutsideVolumes(f"{path}: {error}") from error


def real_path(path: str, roots: Mapping[str, SeenAt | None]) -> str:
    """`path` with its links followed; as it is where it leads to nothing or out of `roots`, which are as for `resolve`."""
    with _Walk(roots) as walk:
        try:
            number = walk.to(path)
        except (OSError, OutsideVolumes):
            number = None
        if number is None:
            return path
        os.close(number)
        return walk.here


class _Walk:
    """Invariant: `number` is the open descriptor of `done`, which contains no links; or None between mounts."""

    def __init__(self, roots: Mapping[str, SeenAt | None], passing: Passing | None = None) -> None:
        self._roots = roots
        self._passing = passing
        self._done: list[str] = []
        self._number: int | None = None

    def __enter__(self) -> _Walk:
        return self

    def __exit__(self, *error: object) -> None:
        self._move(None)

    @property
    def here(self) -> str:
        return "/" + "/".join(self._done)

    def to(self, path: str) -> int | None:
        pending = deque(part for part in path.split("/") if part)
        links = 0
        while pending:
            part = pending.popleft()
            if part == "..":
                # The walked part is free of links, so its text may be shortened.
                self._done = self._done[:-1]
                self._move(None)
                continue
            self._enter(part)
            target = self._link()
            if target is not None:
                links += 1
                if links > MAX_LINKS:
                    return None
                self._done = [] if target.startswith("/") else self._done[:-1]
                self._move(None)
                pending.extendleft(reversed([piece for piece in target.split("/") if piece not in ("", ".")]))
        if self._number is None:
            raise OutsideVolumes(path)
        found, self._number = self._number, None
        return found

    def _move(self, number: int | None) -> None:
        old, self._number = self._number, number
        if old is not None:
            os.close(old)

    def _step(self, part: str) -> None:
        if self._passing is not None and self._number is not None:
            self._passing(self._number, part)
        self._move(os.open(part, _OPEN, dir_fd=self._number))

    def _enter(self, part: str) -> None:
        """Go to `part`; `number` stays None between the root of the image and a mount."""
        self._done.append(part)
        here = self.here
        if here not in self._roots and self._number is not None:
            self._step(part)
            return
        self._move(None)
        covering = [root for root in self._roots if here == root or here.startswith(root.rstrip("/") + "/")]
        if not covering:
            if not any(root.startswith(here + "/") for root in self._roots):
                raise OutsideVolumes(here)
            return
        root = max(covering, key=len)
        seen = self._roots[root]
        if seen is None:
            raise OutsideVolumes(here)
        try:
            self._move(os.open(seen.mount, os.O_PATH | os.O_CLOEXEC))
            for part in filter(None, seen.rest.split("/")):
                self._step(part)
        except OSError as error:
            raise OutsideVolumes(f"{'/'.join(seen)}: {error}") from error  # not visible from here after all
        if self._link() is not None:
            raise OutsideVolumes(f"{'/'.join(seen)} is a link now")
        for below in here[len(root) :].split("/"):
            if below:
                self._step(below)

    def _link(self) -> str | None:
        """The target of an open symbolic link, None for anything else."""
        if self._number is None or not stat.S_ISLNK(os.fstat(self._number).st_mode):
            return None
        return os.readlink("", dir_fd=self._number)
