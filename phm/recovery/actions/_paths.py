"""Opens paths below which applications may write: no link is followed anywhere on the way."""

from __future__ import annotations

import os
from pathlib import PurePosixPath

_STEP = os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC
FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def open_plain(path: str, flags: int) -> int:
    """A descriptor of what is at the absolute `path`, to be closed.

    A program that may write into a folder on the way may put a link in the place of the next one, and so choose what PHM reads, copies or
    removes with its own rights. Raises OSError, ELOOP or ENOTDIR for a link.
    """
    *parents, name = PurePosixPath(os.path.normpath(path)).parts[1:] or (".",)
    handle = os.open("/", _STEP | os.O_DIRECTORY)
    try:
        for parent in parents:
            inner = os.open(parent, _STEP | os.O_DIRECTORY, dir_fd=handle)
            os.close(handle)
            handle = inner
        return os.open(name, flags | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=handle)
    finally:
        os.close(handle)
