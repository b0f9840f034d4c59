"""The events as lines of JSON for other programs: `phm gcs --serve`, and `/stream` of the page's server."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence

from aiohttp import web

from phm.core.clock import Clock
from phm.gcs.events import GcsEvent
from phm.gcs.station import GroundStation
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.gcs.web.access import Handler, public, view
from phm.gcs.web.clients import StreamClient
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.server import WebServer
from phm.gcs.web.server_keys import CLIENTS
from phm.gcs.web.site import Site
from phm.gcs.web.view import View

ALIVE_S = 5.0
LINES, NOT_YET = "application/x-ndjson", 2**62


class LineTap(SubscriberQueue):
    """Hands each event to the clients of a path immediately, and keeps none."""

    def __init__(self, clock: Clock, server: WebServer, path: str) -> None:
        super().__init__(clock, 1)
        self._server, self._path = server, path

    def put(self, item: QueuedEvent) -> bool:
        self._server.send(self._path, item.number, item.line + b"\n")
        return True


def handlers(station: GroundStation, clock: Clock) -> tuple[Handler, Handler]:
    """The handlers of the stream (a snapshot, then every event, `alive` every ALIVE_S) and of a single snapshot."""

    async def stream(request: web.Request) -> web.StreamResponse:
        with request.app[CLIENTS].admit(request, NOT_YET) as client:
            response = web.StreamResponse(headers={"Content-Type": LINES})
            await response.prepare(request)
            number, event = station.snapshot()
            client.seen = number
            client.add(station.line(number, event) + b"\n")
            alive = asyncio.create_task(_alive(station, clock, client))
            try:
                with contextlib.suppress(ConnectionError):  # the program has ended; aiohttp would log a traceback
                    await client.run(response, clock)
            finally:
                alive.cancel()
        return response

    async def snapshot(request: web.Request) -> web.Response:
        return web.Response(body=station.line(*station.snapshot()) + b"\n", content_type="application/json")

    return stream, snapshot


async def _alive(station: GroundStation, clock: Clock, client: StreamClient) -> None:
    while not client.over:
        await asyncio.sleep(ALIVE_S)
        client.add(station.line(client.seen, GcsEvent(clock.stamp(), "alive", {})) + b"\n")


def serve(station: GroundStation, options: ListenOptions, clock: Clock) -> WebServer:
    """A server of the stream alone, for `--serve`. With tokens they are needed. Raises OSError."""

    def add_routes(site: Site) -> Sequence[web.RouteDef]:
        stream, snapshot = handlers(station, clock)
        may = public if options.tokens is None else view
        return [web.get("/", may(stream)), web.get("/snapshot", may(snapshot))]

    server = WebServer(Site(View(clock), clock, page="serve"), options, add_routes)
    station.subscribe(LineTap(clock, server, "/"))
    return server
