"""The Checks page: configurations of agents (`phm.gcs.web.config_editor`). Only for the role operate: a configuration may have secrets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from aiohttp import web

from phm.config import ConfigError
from phm.gcs.web.access import MOST_BODY, HttpProblem, answer, operate, read_json, view
from phm.gcs.web.config_editor import ConfigEditor, NotSaved
from phm.gcs.web.site import Site

EXTRA = "checks"
"""Key of the `ConfigEditor` in `Site.extra`."""


def routes(site: Site) -> Sequence[web.RouteDef]:
    given = site.extra.get(EXTRA)
    editor = given if isinstance(given, ConfigEditor) else None

    def here() -> ConfigEditor:
        if editor is None:
            raise HttpProblem(404, "configurations cannot be edited here")
        return editor

    async def about(request: web.Request) -> web.Response:
        return answer({"edit": editor is not None, "files": editor.files() if editor else []})

    async def schema(request: web.Request) -> web.Response:
        return answer(await _run(here().schema))

    async def open_file(request: web.Request) -> web.Response:
        body = await read_json(request)
        return answer(await _run(lambda: here().open(str(body.get("name")))))

    async def check(request: web.Request) -> web.Response:
        body = await read_json(request, MOST_BODY)
        return answer(await _run(lambda: here().check(body)))

    async def save(request: web.Request) -> web.Response:
        body = await read_json(request, MOST_BODY)
        name, text, version = (body.get(key) for key in ("name", "text", "version"))
        if not (isinstance(name, str) and isinstance(text, str) and isinstance(version, str)):
            raise HttpProblem(400, "send name, text and version")
        return answer(
            await _run(
                lambda: here().save(name, text, version, body.get("variables"), anyway=body.get("anyway") is True)
            )
        )

    return [
        web.get("/api/config", operate(about)),
        web.get("/api/config/schema", view(schema)),
        web.post("/api/config/open", operate(open_file)),
        web.post("/api/config/check", operate(check)),
        web.post("/api/config/save", operate(save)),
    ]


async def _run(ask: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """In a thread: a configuration is read, parsed and validated. Raises HttpProblem."""
    try:
        return await asyncio.to_thread(ask)
    except KeyError:
        raise HttpProblem(404, "there is no such file: `phm gcs --web --edit FILE` allows one") from None
    except NotSaved as refused:
        raise HttpProblem(409, str(refused)) from None
    except (ConfigError, ValueError) as error:
        raise HttpProblem(400, str(error)) from None
