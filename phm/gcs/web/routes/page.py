"""Routes for the files of the page, and for log-in and log-out."""

from __future__ import annotations

from collections.abc import Sequence

from aiohttp import hdrs, web

from phm.gcs.web.access import HttpProblem, answer, public, read_json, view
from phm.gcs.web.config_editor import ConfigEditor
from phm.gcs.web.options import OPERATE
from phm.gcs.web.routes.checks import EXTRA as CHECKS
from phm.gcs.web.server_keys import ACCESS, CLIENTS
from phm.gcs.web.site import Site
from phm.gcs.web.static_files import StaticFile, load

MAX_TOKEN = 1000


def routes(site: Site) -> Sequence[web.RouteDef]:
    found = load()

    def file(request: web.Request, name: str) -> web.Response:
        if name not in found:
            raise HttpProblem(404, "there is no such file")
        return _response(request, found[name])

    async def index(request: web.Request) -> web.Response:
        return file(request, "index.html")

    async def checks(request: web.Request) -> web.Response:
        return file(request, "checks.html")

    async def static(request: web.Request) -> web.Response:
        return file(request, request.match_info["name"])

    async def session(request: web.Request) -> web.Response:
        """Where no token is needed, the sender may operate: only programs of this machine can ask."""
        access = request.app[ACCESS]
        role, csrf = access.session(request)
        if role or access.sessions.tokens is not None:
            return answer(_about(request, site, role, csrf))
        return _begin(request, site, OPERATE)

    async def login(request: web.Request) -> web.Response:
        access = request.app[ACCESS]
        token = (await read_json(request)).get("token")
        if access.sessions.tokens is None:
            return _begin(request, site, OPERATE)
        if not isinstance(token, str) or len(token) > MAX_TOKEN:
            raise HttpProblem(400, 'send {"token": "..."}')
        return _begin(request, site, access.check_token(request, token))

    async def logout(request: web.Request) -> web.Response:
        access = request.app[ACCESS]
        access.sessions.end(request.cookies.get(access.cookie, ""))
        request.app[CLIENTS].prune()  # its streams end with it
        response = answer({})
        response.del_cookie(access.cookie, path="/")
        return response

    return [
        web.get("/", public(index)),
        web.get("/checks", public(checks)),
        web.get("/static/{name:.+}", public(static)),
        web.get("/api/session", public(session)),
        web.post("/api/login", public(login)),
        web.post("/api/logout", view(logout)),
    ]


def _response(request: web.Request, file: StaticFile) -> web.Response:
    """no-cache: the browser asks each time, so a new version of PHM is used immediately."""
    headers = {hdrs.ETAG: f'"{file.etag}"', hdrs.CACHE_CONTROL: "no-cache"}
    if request.headers.get(hdrs.IF_NONE_MATCH) == headers[hdrs.ETAG]:
        return web.Response(status=304, headers=headers)
    text = file.content_type.startswith(("text/", "application/", "image/svg"))
    return web.Response(
        body=file.body, content_type=file.content_type, charset="utf-8" if text else None, headers=headers
    )


def _begin(request: web.Request, site: Site, role: str) -> web.Response:
    access = request.app[ACCESS]
    access.sessions.end(request.cookies.get(access.cookie, ""))
    key, session = access.sessions.begin(role, site.clock.mono(), request.remote or "?")
    response = answer(_about(request, site, session.role, session.csrf))
    secure = access.options.tls is not None or access.options.behind_proxy
    response.set_cookie(access.cookie, key, path="/", httponly=True, samesite="Strict", secure=secure)
    return response


def _about(request: web.Request, site: Site, role: str, csrf: str | None) -> dict[str, object]:
    """role: empty, when the sender has to log in. tokens: whether one can log in, and out. checks: whether there are files to edit."""
    editor, tokens = site.extra.get(CHECKS), request.app[ACCESS].sessions.tokens is not None
    return {
        "role": role or None,
        "csrf": csrf,
        "login": not role,
        "tokens": tokens,
        "page": site.page,
        "checks": role == OPERATE and isinstance(editor, ConfigEditor) and bool(editor.files()),
    }
