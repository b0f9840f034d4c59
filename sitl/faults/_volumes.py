"""The folders of this machine behind a container's volumes, and files there that nothing may write to."""

from __future__ import annotations

import array
import contextlib
import fcntl
import os
from pathlib import Path

from docker.models.containers import Container

FS_IOC_GETFLAGS, FS_IOC_SETFLAGS, FS_IMMUTABLE_FL = 0x80086601, 0x40086602, 0x10
"""Of <linux/fs.h>, on 64 bits."""


def behind(container: Container, path: str) -> Path:
    """The folder of this machine that the container has mounted at `path`. LookupError when it has nothing mounted there."""
    for mount in container.attrs["Mounts"]:
        if mount["Destination"] == path:
            return Path(mount["Source"])
    raise LookupError(f"{container.name} has no volume at {path}")


def immutable(file: Path) -> bool:
    """Whether nothing may write to the file (`lsattr`). Raises OSError."""
    return bool(_flags(file)[0] & FS_IMMUTABLE_FL)


def set_immutable(file: Path, *, on: bool) -> None:
    """``chattr +i`` or ``-i``: writes fail also for those that have it open. Needs root. OSError where the file system cannot."""
    flags = _flags(file)
    flags[0] = flags[0] | FS_IMMUTABLE_FL if on else flags[0] & ~FS_IMMUTABLE_FL
    _ioctl(file, FS_IOC_SETFLAGS, flags)


def release(folder: Path) -> None:
    """Make every file below the folder writable again, as far as possible: nothing could remove it otherwise."""
    for file in folder.rglob("phm.*"):
        with contextlib.suppress(OSError):
            if immutable(file):
                set_immutable(file, on=False)


def _flags(file: Path) -> array.array[int]:
    flags = array.array("l", [0])
    _ioctl(file, FS_IOC_GETFLAGS, flags)
    return flags


def _ioctl(file: Path, request: int, flags: array.array[int]) -> None:
    descriptor = os.open(file, os.O_RDONLY)
    try:
        fcntl.ioctl(descriptor, request, flags)
    finally:
        os.close(descriptor)
