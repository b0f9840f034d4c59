"""Serves measurements to Prometheus: the page /metrics at `metrics.listen`.

`docs/reference/metrics.md` states the names as a contract. A port that cannot be opened is tried again, and is a problem of PHM
meanwhile.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from phm.core.extras import remedy
from phm.core.model import Event, Slot
from phm.core.settings.metrics import is_loopback
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.metrics_counts import KINDS, EventCounts
from phm.reporters.metrics_page import build_page

if TYPE_CHECKING:
    from phm.transport.scrape_server import ScrapeServer

MISSING = f"metrics.listen needs prometheus-client: {remedy('metrics')}"


class MetricsReporter(Reporter):
    """Serves metrics for Prometheus; see the module."""

    name = "metrics"
    period_s = 5.0
    kinds = KINDS

    def __init__(self, context: ReporterContext) -> None:
        self._context = context
        self._counts = EventCounts(self._slot_of)
        self._server: ScrapeServer | None = None
        self._problem = ""
        self.tick()

    @classmethod
    def build(cls, context: ReporterContext) -> MetricsReporter | None:
        return cls(context) if context.settings.metrics.listen is not None else None

    @property
    def address(self) -> tuple[str, int] | None:
        """The address at which it listens."""
        return None if self._server is None else self._server.address

    def handle(self, event: Event) -> None:
        self._counts.take(event)

    def tick(self) -> None:
        if self._server is None:
            self._open()

    def close(self) -> None:
        if self._server is not None:
            self._server.close()

    def problem(self) -> str:
        return self._problem

    def report(self) -> dict[str, object]:
        server = self._server
        if server is None:
            return {"listening": ""}
        return {
            "listening": f"{server.address[0]}:{server.address[1]}",
            "served": server.served,
            "dropped": server.dropped,
        }

    def _open(self) -> None:
        try:
            from phm.transport.scrape_server import ScrapeServer
            from phm.wire.openmetrics import MetricsText, wants_openmetrics
        except ImportError:
            self._problem = MISSING
            return
        listen = self._context.settings.metrics
        text = MetricsText(lambda: build_page(self._context, self._counts))
        host, port = listen.address
        try:
            server = ScrapeServer(
                host, port, text.render, wants_openmetrics, self._context.clock, local=is_loopback(host)
            )
        except OSError as error:
            # Python adds the address to the system's text, but not to that of a name that cannot be resolved.
            why = os.strerror(error.errno) if error.errno and error.errno > 0 else error.strerror
            self._problem = f"metrics: cannot listen on {listen.listen}: {why or error}"
            return
        self._server, self._problem = server, ""
        server.start()

    def _slot_of(self, unit: str) -> Slot | None:
        return next((state.slot for state in self._context.states() if state.unit == unit), None)
