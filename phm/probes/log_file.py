"""Follows a log file that may be rotated, truncated, removed and created again."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass

from phm.facts import CannotTell

READ_BYTES = 256 << 10
"""Of what was written since the last read, at most this many of the newest bytes are read."""
_FLAGS = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY | os.O_NOFOLLOW


@dataclass
class LogFile:
    """Its reader's position. Not thread-safe. A file that is truncated and grows beyond its old size between two reads is read on
    from the old position."""

    path: str
    _handle: int = -1
    _offset: int = 0
    _started: bool = False

    def read(self) -> tuple[bytes, int]:
        """Whole lines that were written since the last call, and how many bytes were left out. The first call only finds the end.

        Raises CannotTell if the file cannot be read.
        """
        first, self._started = not self._started, True
        rest = self._rest() if self._handle >= 0 else (b"", 0)
        if self._handle >= 0 and self._is_current():
            return rest
        self.close()
        try:
            self._handle = os.open(self._target(), _FLAGS)
        except OSError as error:
            if rest[0]:
                return rest
            raise CannotTell(f"{self.path} cannot be read: {error.strerror}") from error
        status = os.fstat(self._handle)
        if not stat.S_ISREG(status.st_mode):
            self.close()
            raise CannotTell(f"{self.path} is not an ordinary file")
        self._offset = status.st_size if first else 0
        new, skipped = self._rest()
        return rest[0] + new, rest[1] + skipped

    def close(self) -> None:
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def _target(self) -> str:
        """The file itself. A link may lead to another name in its folder, as for rotated logs, and not to PHM's other files: who
        writes the log may be hostile."""
        target, folder = os.path.realpath(self.path), os.path.realpath(os.path.dirname(self.path))
        if os.path.commonpath([target, folder]) != folder:
            raise CannotTell(f"{self.path} is a link out of its folder, which is not followed")
        return target

    def _is_current(self) -> bool:
        """Whether the path still names the open file."""
        try:
            there, ours = os.stat(self.path), os.fstat(self._handle)
        except OSError:
            return False
        return (there.st_dev, there.st_ino) == (ours.st_dev, ours.st_ino)

    def _rest(self) -> tuple[bytes, int]:
        size = os.fstat(self._handle).st_size
        if size < self._offset:
            self._offset = 0
        skipped = max(0, size - self._offset - READ_BYTES)
        self._offset += skipped
        data = os.pread(self._handle, READ_BYTES, self._offset)
        whole = data.rfind(b"\n") + 1
        if not whole and len(data) == READ_BYTES:
            whole = len(data)  # a line without end
        self._offset += whole
        return data[:whole], skipped
