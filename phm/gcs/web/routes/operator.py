"""Routes for requests of an operator to an agent."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from aiohttp import web

from phm.gcs.web.access import HttpProblem, answer, operate, read_json, view
from phm.gcs.web.options import OPERATE
from phm.gcs.web.site import RequestRefused, Site


def routes(site: Site) -> Sequence[web.RouteDef]:
    async def choices(request: web.Request) -> web.Response:
        if site.requests is None:
            return answer({"choices": [], "note": site.no_requests})
        try:
            return answer(site.requests.choices(request.query.get("agent", "")))
        except RequestRefused as refusal:
            raise HttpProblem(404, str(refusal)) from None

    async def recent(request: web.Request) -> web.Response:
        return answer({"requests": site.requests.recent() if site.requests is not None else []})

    async def submit(request: web.Request) -> web.Response:
        body = await read_json(request)
        if site.requests is None:
            raise HttpProblem(409, site.no_requests)
        try:
            # Sending never waits for an agent, but takes the lock of the station.
            return answer(await asyncio.to_thread(site.requests.submit, body, OPERATE), 202)
        except RequestRefused as refusal:
            raise HttpProblem(409, str(refusal)) from None
        except ValueError as error:
            raise HttpProblem(400, str(error)) from None

    return [
        web.get("/api/choices", view(choices)),
        web.get("/api/requests", view(recent)),
        web.post("/api/requests", operate(submit)),
    ]
