"""The Checks page: configurations of agents (`phm.gcs.web.config_editor`). Only for the role operate: a configuration may have secrets."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from aiohttp import web

from phm.config import ConfigError
from phm.core.own_thread import NoThread, in_own_thread
from phm.gcs.web.access import MAX_CONFIG_BODY, HttpProblem, answer, operate, read_json, view
from phm.gcs.web.config_delivery import ConfigDelivery, NotDelivered
from phm.gcs.web.config_editor import ConfigEditor, NotSaved
from phm.gcs.web.site import Site

EXTRA = "checks"
"""The key of the `ConfigEditor` in `Site.extra`."""
DELIVERY = "delivery"
"""The key of the `ConfigDelivery` in `Site.extra`, if there is one."""


def routes(site: Site) -> Sequence[web.RouteDef]:
    given = site.extra.get(EXTRA)
    editor = given if isinstance(given, ConfigEditor) else None
    sender = site.extra.get(DELIVERY)
    delivery = sender if isinstance(sender, ConfigDelivery) else ConfigDelivery({})

    def here() -> ConfigEditor:
        if editor is None:
            raise HttpProblem(404, "configurations cannot be edited here")
        return editor

    async def about(request: web.Request) -> web.Response:
        files = editor.files() if editor else []
        return answer({"edit": editor is not None, "files": files, "agents": delivery.targets()})

    async def schema(request: web.Request) -> web.Response:
        return answer(await _run(here().schema))

    async def open_file(request: web.Request) -> web.Response:
        body = await read_json(request)
        return answer(await _run(lambda: here().open(str(body.get("name")))))

    async def check(request: web.Request) -> web.Response:
        body = await read_json(request, MAX_CONFIG_BODY)
        return answer(await _run(lambda: here().check(body)))

    async def save(request: web.Request) -> web.Response:
        body = await read_json(request, MAX_CONFIG_BODY)
        name, text, version = (body.get(key) for key in ("name", "text", "version"))
        if not (isinstance(name, str) and isinstance(text, str) and isinstance(version, str)):
            raise HttpProblem(400, "send name, text and version")
        return answer(
            await _run(
                lambda: here().save(name, text, version, body.get("variables"), anyway=body.get("anyway") is True)
            )
        )

    async def deliver(request: web.Request) -> web.Response:
        """base: version of the configuration that the file was made from; null: replace whatever the agent has."""
        body = await read_json(request)
        name, version, base = (body.get(key) for key in ("name", "version", "base"))
        if not (isinstance(name, str) and isinstance(version, str) and isinstance(base, str | None)):
            raise HttpProblem(400, "send name, version and base")
        # An agent may take a minute to answer, and the end of the program does not wait for it.
        return answer(await _run(lambda: delivery.deliver(name, here().saved(name, version), base), in_delivery_thread))

    return [
        web.get("/api/config", operate(about)),
        web.get("/api/config/schema", view(schema)),
        web.post("/api/config/open", operate(open_file)),
        web.post("/api/config/check", operate(check)),
        web.post("/api/config/save", operate(save)),
        web.post("/api/config/deliver", operate(deliver)),
    ]


Answer = dict[str, Any]
Thread = Callable[[Callable[[], Answer]], Awaitable[Answer]]


async def in_delivery_thread(ask: Callable[[], Answer]) -> Answer:
    return await in_own_thread("phm-web-delivery", ask)


async def _run(ask: Callable[[], Answer], thread: Thread = asyncio.to_thread) -> Answer:
    """In a thread: a configuration is read, parsed and validated. Raises HttpProblem."""
    try:
        return await thread(ask)
    except NoThread:
        raise HttpProblem(503, "no thread can be started: try again") from None
    except KeyError:
        raise HttpProblem(404, "there is no such file: `phm gcs --web --edit FILE` allows one") from None
    except (NotSaved, NotDelivered) as refused:
        raise HttpProblem(409, str(refused)) from None
    except (ConfigError, ValueError) as error:
        raise HttpProblem(400, str(error)) from None
