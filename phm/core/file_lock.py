"""A lock between processes on a file, for programs that write into one folder.

A kernel lock (flock): it is released when the process ends, in whatever way. Windows has none; there nothing is locked.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

if sys.platform == "win32":

    @contextlib.contextmanager
    def locked(path: Path, busy: Exception) -> Iterator[None]:
        yield

else:
    import fcntl

    @contextlib.contextmanager
    def locked(path: Path, busy: Exception) -> Iterator[None]:
        """Makes the file if there is none, and leaves it. Raises `busy` if another process has the lock, and OSError."""
        with path.open("ab") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise busy from None
            yield
