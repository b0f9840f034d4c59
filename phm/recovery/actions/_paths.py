"""Opens paths below which applications may write: no link is followed anywhere on the way."""

from __future__ import annotations

import functools
import operator
import os
from pathlib import PurePosixPath


def _flags(*names: str) -> int:
    """The flags of `os.open` that this system has. A ground computer may lack some: it needs only the names of the actions."""
    return functools.reduce(operator.or_, (int(getattr(os, name, 0)) for name in names))


FOLDER = _flags("O_RDONLY", "O_DIRECTORY", "O_NOFOLLOW", "O_CLOEXEC")
_STEP = _flags("O_PATH", "O_NOFOLLOW", "O_CLOEXEC", "O_DIRECTORY")
_LAST = _flags("O_NOFOLLOW", "O_CLOEXEC")


def open_plain(path: str, flags: int) -> int:
    """A descriptor of what is at the absolute `path`, to be closed.

    Links are refused with OSError (ELOOP or ENOTDIR). A program that may write to a folder of the path could replace the next
    part by a link, and so choose what PHM reads, copies or removes with PHM's rights.
    """
    *parents, name = PurePosixPath(os.path.normpath(path)).parts[1:] or (".",)
    handle = os.open("/", _STEP)
    try:
        for parent in parents:
            inner = os.open(parent, _STEP, dir_fd=handle)
            os.close(handle)
            handle = inner
        return os.open(name, flags | _LAST, dir_fd=handle)
    finally:
        os.close(handle)
