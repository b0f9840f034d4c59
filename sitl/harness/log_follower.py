"""Following PHM's JSON log while it grows: the record from which times and counts are computed."""

from __future__ import annotations

import json
import os
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

Event = dict[str, Any]
POLL_S = 0.02


class Record:
    """One agent's `phm.jsonl`, read as it grows. `events` holds everything read so far.

    The file remains open: PHM renames, compresses and deletes it, and what was not read until then is still there.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self._open: int | None = None
        self._close: Callable[[], object] = lambda: None
        self.events: list[Event] = []

    def update(self) -> None:
        """Read what was added since; an unfinished last line is left for the next time."""
        try:
            there = os.open(self._path, os.O_RDONLY | os.O_CLOEXEC)
        except FileNotFoundError:
            self._take()
            return
        if self._open is not None and os.path.sameopenfile(there, self._open):
            os.close(there)
            self._take()
            return
        self._take()  # what is left of the former file
        self._close()
        self._open, self._offset = there, 0
        self._close = weakref.finalize(self, os.close, there)
        self._take()

    def _take(self) -> None:
        if self._open is None:
            return
        data = os.pread(self._open, max(0, os.fstat(self._open).st_size - self._offset), self._offset)
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
