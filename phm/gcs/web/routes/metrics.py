"""The route `/metrics` for Prometheus."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING

from aiohttp import hdrs, web

from phm.core.extras import remedy
from phm.gcs.metrics import GroundMetrics, MeasuredStation
from phm.gcs.web.access import HttpProblem, view
from phm.gcs.web.site import Site

if TYPE_CHECKING:
    from phm.wire.openmetrics import MetricsText

logger = logging.getLogger(__name__)

AGAIN_S = 0.5
"""The page is rendered at most once in this time for each format."""
MISSING = f"/metrics needs prometheus-client: {remedy('metrics')}"


class _Page:
    """The handler; its counters begin at the start of the server."""

    def __init__(self, site: Site, station: MeasuredStation) -> None:
        self._clock, self._ground = site.clock, GroundMetrics(station, site.clock)
        self._kept: dict[bool, tuple[float, bytes, str] | tuple[float, None, None]] = {}
        self._lock = asyncio.Lock()

    async def handle(self, request: web.Request) -> web.StreamResponse:
        try:
            from phm.wire.openmetrics import MetricsText, wants_openmetrics
        except ImportError:
            raise HttpProblem(503, MISSING) from None
        accept = ",".join(request.headers.getall(hdrs.ACCEPT, ()))
        first = wants_openmetrics(accept)
        async with self._lock:
            kept = self._kept.get(first)
            if kept is None or self._clock.mono() - kept[0] >= AGAIN_S:
                kept = self._kept[first] = await asyncio.to_thread(self._made, MetricsText(self._ground.page), accept)
        if kept[1] is None:
            raise HttpProblem(500, "the metrics cannot be shown: see the server's log")
        return web.Response(body=kept[1], headers={hdrs.CONTENT_TYPE: kept[2]})

    def _made(self, text: MetricsText, accept: str) -> tuple[float, bytes, str] | tuple[float, None, None]:
        """The time is that of the end, also of a failure: neither is repeated all the time."""
        try:
            page, kind = text.render(accept)
        except Exception:  # one bad value must not end the server; the log has the traceback
            logger.exception("the metrics could not be rendered")
            return self._clock.mono(), None, None
        return self._clock.mono(), page, kind


def routes(site: Site) -> Sequence[web.RouteDef]:
    """A page without a station (a replay, one agent) has no metrics: see `metrics.listen` for an agent's own."""
    if site.stream is None:
        return []
    page = _Page(site, site.stream)

    async def metrics(request: web.Request) -> web.StreamResponse:
        return await page.handle(request)

    return [web.get("/metrics", view(metrics))]
