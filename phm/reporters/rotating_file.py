"""A file of lines that survives SIGKILL, power cuts, full disks and removed directories.

Each line is one `os.write` to a descriptor opened with O_APPEND and nothing is buffered in user space, so every written line
survives the death of the process. Lines that cannot be written wait in a bounded ring in memory: not a `BoundedQueue`, because
a line leaves it only after it is on disk, and the last lost line is needed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
from collections import deque
from collections.abc import Callable

from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.reporters.rotated_files import CompressedFiles, PlainFiles, RotatedFiles

RING_LINES = 1000
"""Lines kept in memory while the file cannot be written; older ones are dropped and counted."""
FIRST_RETRY_S = 1.0
LAST_RETRY_S = 30.0
HANGS_S = 5.0
"""A write that takes longer is reported: a failing SD card blocks its writer instead of returning an error."""

# Windows lacks the first, and changes line ends without the second.
_OPENING = os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)

LostLine = Callable[[int, str, bytes], bytes]
"""Returns the line that states how many lines were lost, why, and the last of them."""


class RotatingFile:
    """Appends lines to `path` and rotates it to ``path.1`` .. ``path.<files>`` before it passes `max_size` bytes. compress: to
    ``path.1.gz``, ``path.2.gz`` ..., as many as fit into ``files * max_size`` bytes.

    Invariants: `write` never raises; a file never holds more than `max_size` bytes (a caller's line must be
    shorter), so all files together hold at most ``(files + 1) * max_size``; lines reach the file in the order
    in which they were given. One thread writes; `problem` may be asked from any.
    """

    def __init__(
        self, path: str, *, max_size: int, files: int, clock: Clock, lost_line: LostLine, compress: bool = False
    ) -> None:
        self.path = os.path.abspath(path)
        self._rotated: RotatedFiles = (
            CompressedFiles(self.path, files * max_size) if compress else PlainFiles(self.path, files)
        )
        self._max_size, self._clock, self._lost_line = max_size, clock, lost_line
        self._fd = -1
        self._size = 0
        self._torn = self._dirty = False
        # Not a BoundedQueue: one thread puts and takes, and a line leaves only when it is written.
        self._ring: deque[bytes] = deque()
        self._lost = 0
        self._last_lost = b""
        self._reason = ""
        self._backoff = Backoff(FIRST_RETRY_S, LAST_RETRY_S)
        self._retry_at = 0.0
        self._asked_at: float | None = None

    def write(self, line: bytes, *, sync: bool = False) -> None:
        """Append one line (without its newline). `sync` waits until it is on the disk."""
        self.put(line)
        self.retry(sync=sync)

    def put(self, line: bytes) -> None:
        """Keep one line for the next `write` or `retry`, without access to the disk."""
        if len(self._ring) >= RING_LINES:
            self._last_lost = self._ring.popleft()
            self._lost += 1
        self._ring.append(line)

    def retry(self, *, sync: bool = False, now: bool = False) -> None:
        """Write waiting lines, if the back-off has passed (or `now`)."""
        if not self._ring or (self._reason and not now and self._clock.mono() < self._retry_at):
            return
        self._asked_at = self._clock.mono()
        try:
            self._open()
            self._drain()
            self._dirty = not (sync and self._regular())
            if not self._dirty:
                _sync(self._fd)
            self._reason = ""
            self._backoff.reset()
        except OSError as error:
            self._failed(error)
        finally:
            self._asked_at = None

    def sync(self) -> None:
        """Wait until what was written is on the disk."""
        if self._dirty and self._fd >= 0 and self._regular():
            self._asked_at = self._clock.mono()
            try:
                _sync(self._fd)
                self._dirty = False
            except OSError as error:
                self._failed(error)
            finally:
                self._asked_at = None

    def problem(self) -> str:
        """A sentence while lines cannot be written, else empty."""
        reason, waiting, lost, asked_at = self._reason, len(self._ring), self._lost, self._asked_at
        hangs_s = 0.0 if asked_at is None else self._clock.mono() - asked_at
        if hangs_s > HANGS_S:
            return f"the disk has not answered for {hangs_s:.0f} s to a write to {self.path}"
        if not reason:
            return ""
        return f"cannot write {self.path}: {reason}; {waiting} lines are kept in memory, {lost} lost"

    def close(self) -> None:
        """Try once more to write the waiting lines, then close the file."""
        self.retry(now=True)
        self._close()
        self._rotated.close()

    def _drain(self) -> None:
        if self._lost:
            self._append(self._lost_line(self._lost, self._reason, self._last_lost))
            self._lost = 0
        while self._ring:
            self._append(self._ring[0])
            self._ring.popleft()

    def _append(self, line: bytes) -> None:
        data = (b"\n" if self._torn else b"") + line + b"\n"
        if self._regular() and self._size and self._size + len(data) > self._max_size:
            self._rotate()
            data = line + b"\n"
        try:
            self._put(data)
        except OSError as error:
            # A limit on the size of a file (RLIMIT_FSIZE, FAT) below ours: continue in a new one.
            if error.errno != errno.EFBIG or not self._size:
                raise
            self._rotate()
            self._put(line + b"\n")

    def _put(self, data: bytes) -> None:
        """One write. A partial one (the disk became full) is undone as far as possible."""
        written = os.write(self._fd, data)
        if written == len(data):
            self._size += written
            self._torn = False
            return
        try:
            os.ftruncate(self._fd, self._size)
        except OSError:
            self._size += written
            self._torn = True
        cause = errno.ENOSPC if self._regular() else errno.EAGAIN
        if self._limited(len(data)):
            cause = errno.EFBIG
        raise OSError(cause, os.strerror(cause))

    def _limited(self, more: int) -> bool:
        limit = _size_limit()
        return limit is not None and self._size + more > limit

    def _open(self) -> None:
        """Open the file, again if it was moved or deleted since. Repairs a line torn by a power cut."""
        if self._fd >= 0:
            if self._in_place():
                return
            self._close()
        directory = os.path.dirname(self.path)
        os.makedirs(directory, exist_ok=True)
        # O_NONBLOCK: a log that was replaced by a pipe without a reader must fail, not hang.
        self._fd = os.open(self.path, _OPENING, 0o644)
        self._size = 0
        if self._regular():
            self._size = os.fstat(self._fd).st_size
            # The torn piece stays on a separate line: it may contain the last data before the power cut.
            self._torn = self._size > 0 and _last_byte(self._fd, self._size) != b"\n"
            with self._rotated.lock:
                self._rotated.prune()
            self._rotated.added()

    def _in_place(self) -> bool:
        try:
            there, mine = os.stat(self.path), os.fstat(self._fd)
        except FileNotFoundError:
            return False
        if (there.st_dev, there.st_ino) != (mine.st_dev, mine.st_ino):
            return False
        # Truncated by someone else (`> phm.log`, logrotate's copytruncate): count on from there.
        self._size = mine.st_size
        return True

    def _regular(self) -> bool:
        return stat.S_ISREG(os.fstat(self._fd).st_mode)

    def _rotate(self) -> None:
        """Give the file a number and begin a new one. Only renames, so no content is lost at any moment.

        Without a free number the file is restarted: a log of the last lines is better than none.
        """
        with self._rotated.lock:
            name = self._rotated.make_room()
            if name is None:
                os.ftruncate(self._fd, 0)
                self._size = 0
                return
            # The next sync is of the next file: without this, a power cut could take the end of this one.
            with contextlib.suppress(OSError):
                _sync(self._fd)
            self._close()  # Windows renames no open file
            os.replace(self.path, name)
        self._open()

    def _failed(self, error: OSError) -> None:
        self._reason = error.strerror or type(error).__name__
        self._retry_at = self._clock.mono() + self._backoff.next_s()
        self._close()

    def _close(self) -> None:
        if self._fd >= 0:
            fd, self._fd = self._fd, -1
            # The descriptor is closed in any case; the write reported a write error.
            with contextlib.suppress(OSError):
                os.close(fd)


if sys.platform == "win32":

    def _sync(fd: int) -> None:
        os.fsync(fd)

    def _size_limit() -> int | None:
        return None

    def _last_byte(fd: int, size: int) -> bytes:
        os.lseek(fd, size - 1, os.SEEK_SET)
        return os.read(fd, 1)

else:
    import resource

    def _sync(fd: int) -> None:
        if sys.platform == "linux":
            os.fdatasync(fd)
        else:
            os.fsync(fd)

    def _size_limit() -> int | None:
        """The limit RLIMIT_FSIZE; None: there is no limit."""
        limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
        return None if limit == resource.RLIM_INFINITY else limit

    def _last_byte(fd: int, size: int) -> bytes:
        return os.pread(fd, 1, size - 1)
