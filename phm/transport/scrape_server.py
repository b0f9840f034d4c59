"""Serves one page of text over HTTP to Prometheus: GET /metrics, nothing else, and no client can hold it up.

Not `prometheus_client.start_http_server`: it has a thread for each client and no deadlines. Each client has CLIENT_S in all. When
MAX_CLIENTS are connected, a new one replaces the oldest: Prometheus is served within milliseconds, so that is a slow one. The page
is rendered at most every AGAIN_S for each format, whatever is requested.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus

from phm.core import threads
from phm.core.clock import Clock
from phm.core.stream_server import run, serving

logger = logging.getLogger(__name__)

CLIENT_S = 5.0
MAX_CLIENTS = 16
MAX_HEAD = 8192
AGAIN_S = 0.5
CLOSE_LIMIT_S = 1.0

Render = Callable[[str], tuple[bytes, str]]
"""Takes the header Accept; the page and its content type."""


class _Refused(Exception):
    """status: the HTTP status of the answer; the message is its text."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class ScrapeServer:
    """Listens from the start. Raises OSError when it cannot."""

    def __init__(
        self, host: str, port: int, render: Render, accepts: Callable[[str], bool], clock: Clock, *, local: bool
    ) -> None:
        """accepts: whether the header Accept asks for the first of the two formats. local: only programs of this machine reach the
        address: then only requests for this machine by a local name are answered."""
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._render, self._accepts, self._clock, self._local = render, accepts, clock, local
        self._pages: dict[bool, tuple[float, bytes, str] | tuple[float, None, None]] = {}
        """When each was made; None: it could not be."""
        self._clients: dict[asyncio.Task[None], None] = {}
        """The connected clients, oldest first."""
        self.served = self.dropped = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end = asyncio.Event()
        self._closing = False
        self._thread = threading.Thread(target=lambda: run(self._serve()), name="phm-metrics", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def close(self) -> None:
        self._closing = True
        if self._loop is None:
            self._listener.close()
            return
        with contextlib.suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(self._end.set)
        threads.join(self._thread, CLOSE_LIMIT_S)

    # ------------------------------------------------------------ the thread

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        if not self._closing:
            async with serving(self._listener, self._client, MAX_HEAD):
                await self._end.wait()

    async def _client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        while len(self._clients) >= MAX_CLIENTS:
            oldest = next(iter(self._clients))
            del self._clients[oldest]
            oldest.cancel()
            self.dropped += 1
        self._clients[task] = None
        try:
            await asyncio.wait_for(self._answer(reader, writer), CLIENT_S)
        except asyncio.TimeoutError:
            self.dropped += 1
        finally:
            self._clients.pop(task, None)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        status, kind, head = HTTPStatus.OK, "text/plain; charset=utf-8", b""
        try:
            head = await _head(reader)
            body, kind = self._page(self._request(head))
        except _Refused as refusal:
            status, body = refusal.status, f"{refusal}\n".encode()
        lines = (
            f"HTTP/1.1 {status.value} {status.phrase}",
            f"Content-Type: {kind}",
            f"Content-Length: {len(body)}",
            *(("Allow: GET, HEAD",) if status is HTTPStatus.METHOD_NOT_ALLOWED else ()),
            "Cache-Control: no-store",
            "X-Content-Type-Options: nosniff",
            "Connection: close",
        )
        writer.write("\r\n".join((*lines, "", "")).encode("ascii") + (b"" if head.startswith(b"HEAD ") else body))
        writer.close()
        await writer.wait_closed()
        self.served += status is HTTPStatus.OK

    def _request(self, head: bytes) -> str:
        """The header Accept of a request that may be answered."""
        first, *lines = head.decode("latin-1").splitlines()
        words = first.split(" ")
        if len(words) != 3 or not words[2].startswith("HTTP/1."):
            raise _Refused(HTTPStatus.BAD_REQUEST, "this is not an HTTP request")
        headers = [(name.strip().lower(), value.strip()) for name, _, value in (line.partition(":") for line in lines)]
        hosts = [value for name, value in headers if name == "host"]
        if self._local and not all(_is_local(host) for host in hosts):
            raise _Refused(HTTPStatus.FORBIDDEN, "the Host header names another machine")
        if words[0] not in ("GET", "HEAD"):
            raise _Refused(HTTPStatus.METHOD_NOT_ALLOWED, "only GET is served")
        if words[1].partition("?")[0] != "/metrics":
            raise _Refused(HTTPStatus.NOT_FOUND, "only /metrics is served")
        return ",".join(value for name, value in headers if name == "accept")

    def _page(self, accept: str) -> tuple[bytes, str]:
        first = self._accepts(accept)
        kept = self._pages.get(first)
        if kept is None or self._clock.mono() - kept[0] >= AGAIN_S:
            kept = self._pages[first] = self._made(accept)
        if kept[1] is None:
            raise _Refused(HTTPStatus.INTERNAL_SERVER_ERROR, "the metrics cannot be shown: see PHM's log")
        return kept[1], kept[2]

    def _made(self, accept: str) -> tuple[float, bytes, str] | tuple[float, None, None]:
        """The time is that of the end: what takes long is not done all the time."""
        try:
            page, kind = self._render(accept)
        except Exception:  # a failure must not end the server, and its text is not for clients
            logger.exception("the metrics could not be rendered")
            return self._clock.mono(), None, None
        return self._clock.mono(), page, kind


async def _head(reader: asyncio.StreamReader) -> bytes:
    """The request up to its empty line. Raises _Refused, and ConnectionError if the client ends before."""
    try:
        return await reader.readuntil(b"\r\n\r\n")
    except asyncio.IncompleteReadError:
        raise ConnectionError("the client closed the connection before its request was complete") from None
    except asyncio.LimitOverrunError:
        raise _Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "the request is too long") from None


def _is_local(host: str) -> bool:
    """Whether a header Host names this machine: on loopback, a web page of anywhere can have its own name point here."""
    name = host.partition("]")[0].strip("[") if host.startswith("[") else host.partition(":")[0]
    return name.lower() in ("localhost", "::1") or (name.startswith("127.") and name.replace(".", "").isdigit())
