"""Ensure that only one PHM uses a state and run directory.

A kernel lock (flock) on a file in each directory: it is released when the process ends, in whatever way.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import platform

NAME = "phm.lock"


class AlreadyRunning(Exception):
    """Another PHM uses one of the directories; the message names the directory, the process and the remedy."""


class InstanceLock:
    """Held until `release` or the end of the process; child processes do not inherit it."""

    def __init__(self, *directories: str) -> None:
        self._directories = tuple(dict.fromkeys(os.path.realpath(directory) for directory in directories))
        self._held: list[int] = []
        self.problem = ""
        """A sentence if a directory could not be locked, e.g. a read-only one: PHM runs anyway."""

    def acquire(self) -> None:
        """Lock every directory, or none. Raises AlreadyRunning."""
        for directory in self._directories:
            try:
                self._lock(directory)
            except AlreadyRunning:
                self.release()
                raise
            except OSError as error:
                reason = error.strerror or error
                self.problem = (
                    f"cannot lock {directory}: {reason}; a second PHM with the same directory would not be detected"
                )

    def release(self) -> None:
        while self._held:
            os.close(self._held.pop())

    def _lock(self, directory: str) -> None:
        os.makedirs(directory, exist_ok=True)
        path = os.path.join(directory, NAME)
        while True:
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _is_there(lock, path):
                    break
                os.close(lock)  # deleted in between: another file is the lock now
            except BlockingIOError:
                holder = _text(lock)
                os.close(lock)
                raise AlreadyRunning(
                    f"another PHM{f' ({holder})' if holder else ''} uses {directory}: stop it first, or configure a separate "
                    "state_dir and run_dir for this one"
                ) from None
            except OSError:
                os.close(lock)
                raise
        self._held.append(lock)
        with contextlib.suppress(OSError):  # a full disk: the lock works without its text
            os.ftruncate(lock, 0)
            os.pwrite(lock, f"process {os.getpid()} on {platform.node()}\n".encode(), 0)


def _is_there(lock: int, path: str) -> bool:
    mine = os.fstat(lock)
    try:
        there = os.stat(path, follow_symlinks=False)
    except FileNotFoundError:
        return False
    return (mine.st_dev, mine.st_ino) == (there.st_dev, there.st_ino)


def _text(lock: int) -> str:
    """The text of the holder, only printable characters, because it is shown to the operator."""
    try:
        found = os.pread(lock, 200, 0).decode("utf-8", "replace").strip()
    except OSError:
        return ""
    return found if found.isprintable() else ""
