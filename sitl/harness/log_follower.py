"""Following PHM's JSON log while it grows: the record from which times and counts are computed."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Event = dict[str, Any]
POLL_S = 0.02


class Record:
    """One agent's `phm.jsonl`, read as it grows. `events` holds everything read so far.

    A file that was rotated away since the last look is read to its end first; one rotation at a time.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._inode: int | None = None
        self.events: list[Event] = []

    def update(self) -> None:
        """Read what was added since; an unfinished last line is left for the next time."""
        try:
            inode = self._path.stat().st_ino
        except FileNotFoundError:
            return
        if self._inode not in (None, inode):
            self._take(self._path.with_name(f"{self._path.name}.1"), self._inode)
            self._offset = 0
        self._inode = inode
        self._take(self._path, inode)

    def _take(self, path: Path, inode: int | None) -> None:
        """What is new in the file, if it still is the one that is meant: else it has been rotated meanwhile."""
        try:
            with path.open("rb") as stream:
                if os.fstat(stream.fileno()).st_ino != inode:
                    return
                stream.seek(self._offset)
                data = stream.read()
        except FileNotFoundError:
            return
        whole = data.rfind(b"\n") + 1
        self._offset += whole
        for line in data[:whole].splitlines():
            try:
                self.events.append(json.loads(line))
            except ValueError:
                continue

    def wait(self, wanted: Callable[[Event], bool], limit_s: float, *, since: int = 0) -> Event | None:
        """The first event from index `since` on that is wanted, or None after `limit_s` seconds."""
        end = time.monotonic() + limit_s
        seen = since
        while True:
            self.update()
            for event in self.events[seen:]:
                seen += 1
                if wanted(event):
                    return event
            if time.monotonic() > end:
                return None
            time.sleep(POLL_S)
