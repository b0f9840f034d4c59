"""Routes for series, events and faults of the past."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from typing import Any

from aiohttp import web

from phm.gcs.web.access import Handler, HttpProblem, answer, view
from phm.gcs.web.history.reader import HistoryError, HistoryReader
from phm.gcs.web.site import Site

DEFAULT_S = 600.0
MAX_TEXT = 200
MAX_QUERIES, MAX_WAITING = 2, 64
"""Simultaneous queries, so that requests of an operator always find a thread; and these with those that wait."""


def routes(site: Site) -> Sequence[web.RouteDef]:
    turn, waiting = asyncio.Semaphore(MAX_QUERIES), [0]

    def handler(ask: Callable[[Site, HistoryReader, web.Request], Any]) -> Handler:
        async def handle(request: web.Request) -> web.Response:
            if site.history is None:
                raise HttpProblem(404, "this page has no history")
            if waiting[0] >= MAX_WAITING:
                raise HttpProblem(503, "too many history queries: try again")
            waiting[0] += 1
            try:
                async with turn:
                    return answer(await asyncio.to_thread(ask, site, site.history, request))
            except HistoryError as error:
                raise HttpProblem(503, str(error)) from None
            finally:
                waiting[0] -= 1

        return view(handle)

    return [
        web.get("/api/history/series", handler(_series)),
        web.get("/api/history/kinds", handler(_kinds)),
        web.get("/api/history/events", handler(_events)),
        web.get("/api/history/faults", handler(_faults)),
        web.get("/api/history/flight", handler(_flight)),
    ]


def _series(site: Site, history: HistoryReader, request: web.Request) -> Any:
    who, utc = _text(request, "agent"), site.view.moment()[1]
    until = min(_number(request, "until", utc), _shown_until(site))
    since = (
        _armed(site, history, who)
        if request.query.get("since") == "armed"
        else _number(request, "since", until - DEFAULT_S)
    )
    if since > until:
        raise HttpProblem(400, "since is after until")
    points = int(_number(request, "points", 600))
    return history.series(who, _text(request, "kind"), since, until, points)


def _kinds(site: Site, history: HistoryReader, request: web.Request) -> Any:
    return {"kinds": history.kinds(_text(request, "agent"))}


def _events(site: Site, history: HistoryReader, request: web.Request) -> Any:
    before = request.query.get("before")
    if before is not None and not (before.isascii() and before.isdecimal() and len(before) < 18):
        raise HttpProblem(400, "before must be the id of an event")
    return history.events(
        who=_text(request, "agent"),
        event=_text(request, "event"),
        text=_text(request, "q"),
        grade=_text(request, "grade"),
        before=None if before is None else int(before),
        until=_shown_until(site),
        limit=int(_number(request, "limit", 200)),
    )


def _faults(site: Site, history: HistoryReader, request: web.Request) -> Any:
    until = _shown_until(site)
    since = until if request.query.get("open") == "1" else _number(request, "since", 0.0)
    return history.faults(_text(request, "agent"), since=since, until=until)


def _flight(site: Site, history: HistoryReader, request: web.Request) -> Any:
    return history.flight(_text(request, "agent"), _shown_until(site))


def _armed(site: Site, history: HistoryReader, who: str) -> float:
    since = history.flight(who, _shown_until(site))["since"]
    if since is None:
        raise HttpProblem(409, "no arming of the autopilot of this agent is known")
    return float(since)


def _shown_until(site: Site) -> float:
    """UTC seconds: in a replay, the end of the record is the future."""
    return site.view.moment()[1] if site.replay is not None else math.inf


def _text(request: web.Request, name: str) -> str:
    value = request.query.get(name, "")
    if len(value) > MAX_TEXT:
        raise HttpProblem(400, f"{name} has more than {MAX_TEXT} characters")
    return value


def _number(request: web.Request, name: str, default: float) -> float:
    value = request.query.get(name)
    try:
        found = default if value is None else float(value)
    except ValueError:
        found = math.nan
    if not math.isfinite(found) or abs(found) > 1e11:
        raise HttpProblem(400, f"{name} must be a number")
    return found
