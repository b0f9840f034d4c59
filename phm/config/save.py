"""Replaces the file of a configuration: completely or not at all, also if the power fails."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path


def replace(path: Path, data: bytes, like: Path | None = None) -> None:
    """Atomically, with the owner and the permissions of `like` (default: of the present file). Raises OSError.

    A killed process leaves the old or the new file; at most a file with the name of `path`, a dot before and random letters behind.
    """
    present = (like or path).stat()
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        if hasattr(os, "chown"):
            with suppress(PermissionError):  # only root may give a file to somebody else
                os.chown(temporary, present.st_uid, present.st_gid)
        os.chmod(temporary, present.st_mode & 0o777)
        os.replace(temporary, path)
    except BaseException:
        with suppress(OSError):
            os.unlink(temporary)
        raise
    _sync(path.parent)


def _sync(folder: Path) -> None:
    """So that the new name is on disk, too. Windows cannot open a folder."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
