"""Routes for the stream of `--serve`, at the page's address."""

from __future__ import annotations

from collections.abc import Sequence

from aiohttp import web

from phm.gcs.web.access import view
from phm.gcs.web.site import Site
from phm.gcs.web.stream import handlers


def routes(site: Site) -> Sequence[web.RouteDef]:
    if site.stream is None:
        return []
    stream, snapshot = handlers(site.stream, site.clock)
    return [web.get("/stream", view(stream)), web.get("/snapshot", view(snapshot))]
