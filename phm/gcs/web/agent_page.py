"""The page of `phm status --web`: one agent, from its own status file. It is for looking: it sends no request."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from phm.core import threads
from phm.core.clock import Clock
from phm.gcs.web import agent_row
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.server import WebServer
from phm.gcs.web.site import Site
from phm.gcs.web.view import View

logger = logging.getLogger(__name__)

READ_S = 0.5
"""Seconds between two reads of the status file; the daemon writes it on each change."""
CLOSE_LIMIT_S = 3.0
NO_REQUESTS = (
    "this page only shows: use `phm hold`, `phm release` and `phm approve` on this computer, or a ground station"
)

ReadStatus = Callable[[], tuple[dict[str, Any], str]]
"""Reads the status: the document, empty when there is none, and why the daemon is not healthy, else empty."""


class AgentPage:
    """Listens once it is constructed. Raises OSError if the address cannot be used."""

    def __init__(self, read: ReadStatus, options: ListenOptions, clock: Clock) -> None:
        self._read, self._clock, self._view = read, clock, View(clock)
        site = Site(self._view, clock, page="status", no_requests=NO_REQUESTS, on_clients=self._count)
        self.server = WebServer(site, options)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-web-status", daemon=True)
        self.read()

    @property
    def url(self) -> str:
        return self.server.url

    def start(self) -> None:
        threads.start(self._thread)
        self.server.start()

    def read(self) -> None:
        """Read the status file and show what the daemon wrote."""
        document, problem = self._read()
        self._view.run = agent_row.text(document.get("boot_id", ""))
        row = {agent_row.name(document): agent_row.row(document, problem)}
        self._view.put(ground=agent_row.ground(document, problem), agents=row, complete=True)

    def close(self) -> None:
        self._stop.set()
        threads.join(self._thread, CLOSE_LIMIT_S)
        self.server.close()

    def _loop(self) -> None:
        while not self._clock.wait(self._stop, READ_S):
            try:
                self.read()
            except Exception:  # a status of another version must not end the page
                logger.exception("the status cannot be shown")

    def _count(self, clients: int, dropped: int) -> None:
        self._view.put(ground={"clients": clients, "dropped": dropped})
