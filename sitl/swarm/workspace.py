"""Where a swarm keeps its files on this machine, and the lock that lets one command at a time work on it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

POLL_S = 0.2
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,39}\Z")


def base() -> Path:
    """The folder of all swarms: the environment's PHM_SITL_DIR, else one in the folder of temporary files."""
    return Path(os.environ.get("PHM_SITL_DIR") or Path(tempfile.gettempdir()) / "phm-sitl")


def folder(name: str) -> Path:
    """The folder of one swarm. ValueError for a name that Compose would not take."""
    if not _NAME.match(name) or name.endswith("-air"):
        raise ValueError(f"{name!r} is not a name for a swarm: 1 to 40 small letters, digits and '-', the first no '-'")
    return base() / name


@contextlib.contextmanager
def locked(name: str, limit_s: float) -> Iterator[int]:
    """While it is held no other `up` or `down` works on the swarm; the open file, for children to inherit.

    Compose inherits it: when `up` is killed, the lock is free only when the last of its children has ended, so
    `down` cannot overlook what such a child was about to make. RuntimeError when it is not free in time.
    """
    base().mkdir(parents=True, exist_ok=True)
    path = folder(name).with_suffix(".lock")
    with path.open("a+") as stream:
        _take(stream.fileno(), path, limit_s)
        stream.truncate(0)
        stream.write(f"{os.getpid()}\n")
        stream.flush()
        yield stream.fileno()


def _take(file: int, path: Path, limit_s: float) -> None:
    until_s = time.monotonic() + limit_s
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() >= until_s:
                who = path.read_text().strip() or "unknown"
                raise RuntimeError(
                    f"another command works on this swarm (begun by process {who}, {path}): wait for it or end it"
                ) from None
            time.sleep(POLL_S)
        else:
            return
