"""Routes for the state of all agents and its changes, as server-sent events."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence

from aiohttp import web

from phm.gcs.web.access import answer, view
from phm.gcs.web.clients import StreamClient
from phm.gcs.web.server_keys import CLIENTS
from phm.gcs.web.site import Site
from phm.gcs.web.view import message

PING_S = 5.0
NOTHING_YET = 2**62
"""A client that waits for its first, complete message gets no others."""


def routes(site: Site) -> Sequence[web.RouteDef]:
    async def state(request: web.Request) -> web.Response:
        return answer(site.view.state())

    async def live(request: web.Request) -> web.StreamResponse:
        with request.app[CLIENTS].admit(request, NOTHING_YET) as client:
            response = web.StreamResponse(headers={"Content-Type": "text/event-stream", "X-Accel-Buffering": "no"})
            await response.prepare(request)
            number, full = site.view.full()
            client.seen = number
            client.add(full)
            ping = asyncio.create_task(_ping(site, client))
            try:
                with contextlib.suppress(ConnectionError):  # the page was closed; aiohttp would log a traceback
                    await client.run(response, site.clock)
            finally:
                ping.cancel()
        return response

    return [web.get("/api/state", view(state)), web.get("/api/live", view(live))]


async def _ping(site: Site, client: StreamClient) -> None:
    while not client.over:
        await asyncio.sleep(PING_S)
        now, utc = site.view.moment()
        client.add(message("ping", {"now": round(now, 3), "utc": round(utc, 3)}))
