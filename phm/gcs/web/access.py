"""Who may do what: every request passes here before its handler. A route says who may use it; one that does not is refused."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlsplit

from aiohttp import hdrs, web

from phm.core.clock import Clock
from phm.gcs.web.options import OPERATE, VIEW, ListenOptions, is_loopback
from phm.gcs.web.sessions import Sessions

logger = logging.getLogger(__name__)

CSRF = "X-PHM-CSRF"
MAX_BODY = 65_536
MAX_CONFIG_BODY = 1_048_576
"""Of a request with files of the configuration."""
MAX_URL = 4096
BODY_S = 10.0
"""The complete body of a request must arrive within this time."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; font-src 'self'; "
    "manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Cache-Control": "no-store",
}

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class HttpProblem(Exception):
    """The request is refused: an HTTP status and a sentence."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


def public(handler: Handler) -> Handler:
    """Allow everyone who reaches the server: the response has nothing of the swarm."""
    handler.phm_role = ""  # type: ignore[attr-defined]
    return handler


def view(handler: Handler) -> Handler:
    """Allow the roles view and operate."""
    handler.phm_role = VIEW  # type: ignore[attr-defined]
    return handler


def operate(handler: Handler) -> Handler:
    """Allow the role operate alone."""
    handler.phm_role = OPERATE  # type: ignore[attr-defined]
    return handler


async def read_json(request: web.Request, limit: int = MAX_BODY) -> dict[str, Any]:
    """The body, a JSON object of at most `limit` bytes. Raises HttpProblem."""
    if (request.content_length or 0) > limit:
        raise HttpProblem(413, f"the body has more than {limit} bytes")
    try:
        data = await asyncio.wait_for(request.read(), BODY_S)
    except asyncio.TimeoutError:
        raise HttpProblem(408, "the body did not arrive in time") from None
    except web.HTTPRequestEntityTooLarge:
        raise HttpProblem(413, f"the body has more than {limit} bytes") from None
    if len(data) > limit:
        raise HttpProblem(413, f"the body has more than {limit} bytes")
    try:
        body = json.loads(data)
    except (ValueError, RecursionError):
        raise HttpProblem(400, "the body is not JSON") from None
    if not isinstance(body, dict):
        raise HttpProblem(400, "the body is not a JSON object")
    return body


def answer(body: object, status: int = 200) -> web.Response:
    """A response with `body` as JSON."""
    return web.Response(
        text=json.dumps(body, separators=(",", ":"), allow_nan=False, default=str),
        status=status,
        content_type="application/json",
    )


class AccessControl:
    """Checks every request before its handler; `middleware` is called by aiohttp."""

    def __init__(self, options: ListenOptions, port: int, clock: Clock) -> None:
        """port: the port on which the server listens."""
        self.options, self._clock = options, clock
        self.sessions = Sessions(options.tokens)
        self.cookie = f"phm_session_{port}"
        """Has the port in its name: a browser sends the cookies of a host to all its ports."""

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        try:
            await self._admit(request)
            return await handler(request)
        except HttpProblem as problem:
            response = answer({"error": str(problem)}, problem.status)
            if problem.status in (408, 413):
                response.force_close()
            return response
        except web.HTTPException as error:
            return answer({"error": error.reason.lower()}, error.status)
        except asyncio.CancelledError:
            raise
        except ConnectionError:
            raise
        except Exception:  # a failure of one request must not show its traceback, and not affect the others
            logger.exception("a request to the page failed")
            return answer({"error": "internal error: see the server's log"}, 500)

    async def headers(self, request: web.Request, response: web.StreamResponse) -> None:
        """Add the security headers to a response."""
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        response.headers[hdrs.SERVER] = "phm"

    def session(self, request: web.Request) -> tuple[str, str | None]:
        """The role of the sender, empty for none, and the CSRF value that it must send; None: it need not. Raises HttpProblem."""
        now, bearer = self._clock.mono(), request.headers.get(hdrs.AUTHORIZATION, "")
        if bearer:
            return self._by_token(request, bearer), None
        found = self.sessions.find(request.cookies.get(self.cookie, ""), now)
        return ("", None) if found is None else (found.role, found.csrf)

    def lasts(self, request: web.Request) -> bool:
        """Whether the sender of an endless response is still logged in. Counts as use of its session."""
        if self.sessions.tokens is None or request.headers.get(hdrs.AUTHORIZATION):
            return True
        return self.sessions.find(request.cookies.get(self.cookie, ""), self._clock.mono()) is not None

    def check_token(self, request: web.Request, token: str) -> str:
        """The role of a token. Raises HttpProblem."""
        now, address = self._clock.mono(), request.remote or "?"
        if self.sessions.blocked(address, now):
            raise HttpProblem(429, "too many wrong tokens: wait a minute")
        role = self.sessions.role_of(token)
        if not role:
            self.sessions.failed(address, now)
            raise HttpProblem(403, "the token is wrong")
        return role

    def same_origin(self, request: web.Request) -> bool:
        """Whether a page of another origin sent it, by what the browser says; programs say nothing."""
        site = request.headers.get("Sec-Fetch-Site")
        if site is not None and site not in ("same-origin", "none"):
            return False
        origin = request.headers.get(hdrs.ORIGIN)
        if origin is None:
            return site != "none" or request.method in ("GET", "HEAD")
        try:
            parts = urlsplit(origin)
        except ValueError:
            return False
        schemes = ("http", "https") if self.options.behind_proxy else ("https" if self.options.tls else "http",)
        return parts.scheme in schemes and parts.netloc.lower() == (request.headers.get(hdrs.HOST) or "").lower()

    # ------------------------------------------------------------ checks

    async def _admit(self, request: web.Request) -> None:
        if len(request.raw_path) > MAX_URL:
            raise HttpProblem(414, f"the URL has more than {MAX_URL} characters")
        self._check_host(request)
        handler = request.match_info.handler
        role = getattr(handler, "phm_role", None)
        if request.match_info.http_exception is not None:
            return
        if role is None:
            raise HttpProblem(403, "no role is defined for this route")
        changes = request.method not in ("GET", "HEAD")
        if (changes or role or request.path.startswith("/api/")) and not self.same_origin(request):
            raise HttpProblem(403, "the request comes from a page of another origin")
        if changes and request.content_type != "application/json":
            raise HttpProblem(415, "send JSON: Content-Type: application/json")
        if role:
            self._check_role(request, role, changes=changes)

    def _check_role(self, request: web.Request, needed: str, *, changes: bool) -> None:
        role, csrf = self.session(request)
        if not role and needed == VIEW and not changes and self.sessions.tokens is None:
            return  # any sender could open a session first: programs of this machine need not
        if not role:
            raise HttpProblem(401, "log in first")
        if needed == OPERATE and role != OPERATE:
            raise HttpProblem(403, "this needs the role operate")
        if changes and csrf is not None and not _same(request.headers.get(CSRF, ""), csrf):
            raise HttpProblem(403, f"the header {CSRF} is missing or wrong")

    def _check_host(self, request: web.Request) -> None:
        """On loopback, refuse other names: a page of any site can let its name point here, and the Host header has that name."""
        if not self.options.loopback or self.options.behind_proxy:
            return
        try:
            name = urlsplit(f"//{request.headers.get(hdrs.HOST, '')}").hostname or ""
        except ValueError:
            name = ""
        if not is_loopback(name):
            raise HttpProblem(403, "the Host header names another machine")

    def _by_token(self, request: web.Request, header: str) -> str:
        kind, _, token = header.partition(" ")
        if kind.lower() != "bearer" or self.sessions.tokens is None:
            raise HttpProblem(401, "log in first")
        return self.check_token(request, token.strip())


def _same(said: str, csrf: str) -> bool:
    return hmac.compare_digest(said.encode("utf-8", "surrogateescape"), csrf.encode("ascii"))
