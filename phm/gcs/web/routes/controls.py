"""Routes to acknowledge and silence alarms, and to control a replay."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from aiohttp import web

from phm.gcs.web.access import HttpProblem, answer, operate, read_json
from phm.gcs.web.site import Site


def routes(site: Site) -> Sequence[web.RouteDef]:
    async def alarms(request: web.Request) -> web.Response:
        body = await read_json(request)
        if site.alarms is None:
            raise HttpProblem(409, "this page has no alarms")
        try:
            site.alarms.control(body, site.view.moment()[0])
        except ValueError as error:
            raise HttpProblem(400, str(error)) from None
        return answer({})

    async def replay(request: web.Request) -> web.Response:
        body = await read_json(request)
        if site.replay is None:
            raise HttpProblem(409, "this page does not replay a record")
        try:
            await asyncio.to_thread(site.replay.control, body)
        except ValueError as error:
            raise HttpProblem(400, str(error)) from None
        return answer({})

    return [web.post("/api/alarms", operate(alarms)), web.post("/api/replay", operate(replay))]
