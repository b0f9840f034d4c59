"""Replaces the file of a configuration: completely or not at all, also if the power fails."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path


def replace(path: Path, data: bytes, like: Path | None = None) -> None:
    """Atomically, as far as PHM's user may with the owner, group and permissions of `like` (default: of the present file).

    Raises OSError. A killed process leaves the old or the new file; at most a file with the name of `path`, a dot before and
    random letters behind.
    """
    present = (like or path).stat()
    mode = present.st_mode & 0o777
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        mode &= ~_give(temporary, present)
        os.chmod(temporary, mode)
        os.replace(temporary, path)
    except BaseException:  # also at Ctrl-C: no temporary file stays
        with suppress(OSError):
            os.unlink(temporary)
        raise
    _sync(path.parent)


def _give(temporary: str, like: os.stat_result) -> int:
    """Owner and group as far as PHM's user may; the permissions that must go, because another group would get them."""
    if not hasattr(os, "chown"):
        return 0
    for owner in (like.st_uid, -1):  # only root may give a file to another user
        with suppress(PermissionError):
            os.chown(temporary, owner, like.st_gid)
            return 0
    return 0o070


def _sync(folder: Path) -> None:
    """So that the new name is on disk, too. Windows cannot open a folder."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
