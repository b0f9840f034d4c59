"""The page of `phm status --web`: one agent, from its own status file. It is for looking: it sends no request."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from phm.core import threads
from phm.core.clock import Clock
from phm.gcs.web import agent_row
from phm.gcs.web.history.reader import HistoryReader
from phm.gcs.web.history.status_recorder import StatusRecorder
from phm.gcs.web.history.store import HistoryStore
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.server import WebServer
from phm.gcs.web.site import Site
from phm.gcs.web.view import View

logger = logging.getLogger(__name__)

READ_S = 0.5
"""Seconds between two reads of the status file; the daemon writes it on each change."""
MAX_BYTES = 20_000_000
IDLE_S = 30.0
"""Seconds between two writes of samples while no browser shows the page: it may be on an SD card."""
CLOSE_LIMIT_S = 3.0
NO_REQUESTS = (
    "this page only shows: use `phm hold`, `phm release` and `phm approve` on this computer, or a ground station"
)

ReadStatus = Callable[[], tuple[dict[str, Any], str]]
"""Reads the status: the document, empty when there is none, and why the daemon is not healthy, else empty."""


class AgentPage:
    """Listens once it is constructed. Raises OSError if the address cannot be used. history: as of `GroundPage`."""

    def __init__(self, read: ReadStatus, options: ListenOptions, clock: Clock, history: Path | None = None) -> None:
        self._read, self._clock, self._view = read, clock, View(clock)
        self._store = HistoryStore(history, clock, max_bytes=MAX_BYTES, idle_s=IDLE_S)
        reader = HistoryReader(self._store.path)
        site = Site(self._view, clock, page="status", no_requests=NO_REQUESTS, on_clients=self._count, history=reader)
        try:
            self.server = WebServer(site, options)
        except OSError:
            self._store.close()
            raise
        self._recorder, self._reading = StatusRecorder(self._store, reader), threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-web-status", daemon=True)
        self.read()

    @property
    def url(self) -> str:
        return self.server.url

    def start(self) -> None:
        self._store.start()
        threads.start(self._thread)
        self.server.start()

    def about(self) -> str:
        """Why the history is not kept, else empty."""
        return self._store.problem()

    def read(self) -> None:
        """Read the status file and show what the daemon wrote."""
        with self._reading:
            document, problem = self._read()
            self._view.run = agent_row.text(document.get("boot_id", ""))
            name, row = agent_row.name(document), agent_row.row(document, problem)
            ground = {**agent_row.ground(document, problem), "history": {"problem": self._store.problem()}}
            self._view.put(ground=ground, agents={name: row}, complete=True)
            self._view.add_events(self._recorder.take(document, row, self._clock.stamp()))

    def close(self) -> None:
        self._stop.set()
        threads.join(self._thread, CLOSE_LIMIT_S)
        self.server.close()
        self._store.close()

    def _loop(self) -> None:
        while not self._clock.wait(self._stop, READ_S):
            try:
                self.read()
            except Exception:  # a status of another version must not end the page
                logger.exception("the status cannot be shown")

    def _count(self, clients: int, dropped: int) -> None:
        self._store.watched = clients > 0
        self._view.put(ground={"clients": clients, "dropped": dropped})
