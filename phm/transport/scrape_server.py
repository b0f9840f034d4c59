"""Serve one page of text over HTTP to Prometheus: GET /metrics, nothing else, and no client can hold it up.

Built on `socketserver` and `http.server`, which prometheus-client imports anyway. These have no limits for clients, so
`ScrapeServer` adds them: CLIENT_S in all for each client, at most MAX_CLIENTS clients and threads, MAX_HEAD bytes of a request.
`prometheus_client.start_http_server` has the same base without these limits, and `HTTPServer` asks DNS for its own name.

When MAX_CLIENTS are connected, a new one replaces the oldest: Prometheus is served within milliseconds, so that is a slow one. The
page is rendered at most every AGAIN_S for each format, whatever is requested.
"""

from __future__ import annotations

import contextlib
import io
import logging
import math
import socket
import sys
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.client import LineTooLong
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from typing import Any

from phm.core import threads
from phm.core.clock import Clock

logger = logging.getLogger(__name__)

CLIENT_S = 5.0
MAX_CLIENTS = 16
MAX_HEAD = 8192
AGAIN_S = 0.5
CLOSE_LIMIT_S = 1.0
DROP_LIMIT_S = 1.0
"""How long a new client waits for the thread of the one that it replaces."""
RETRY_S = 1.0
"""After a failure to accept, such as too many open files."""

Render = Callable[[str], tuple[bytes, str]]
"""Takes the header Accept; the page and its content type."""


class ScrapeServer(ThreadingTCPServer):
    """Listens from the start. Raises OSError when it cannot."""

    allow_reuse_address = True
    request_queue_size = MAX_CLIENTS

    def __init__(
        self, host: str, port: int, render: Render, accepts: Callable[[str], bool], clock: Clock, *, local: bool
    ) -> None:
        """accepts: whether the header Accept asks for the first of the two formats. local: only programs of this machine reach the
        address: then only requests for this machine by a local name are answered."""
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.local = local
        self.served = self.dropped = 0
        self._pages = _Pages(render, accepts, clock)
        self._clients: dict[socket.socket, float] = {}
        """The connected clients, oldest first, with the time until which each is served; never for one that was dropped."""
        self._changed = threading.Condition()
        self._end = threading.Event()
        super().__init__((host, port), _Request)
        self.address: tuple[str, int] = self.socket.getsockname()[:2]
        self._thread = threading.Thread(target=self._serve, name="phm-metrics", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def close(self) -> None:
        self._end.set()
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits for clients
        threads.join(self._thread, CLOSE_LIMIT_S)
        self.server_close()
        with self._changed:
            for client in self._clients:
                self._drop(client)
            self._changed.wait_for(lambda: not self._clients, CLOSE_LIMIT_S)

    def page(self, accept: str) -> tuple[bytes, str] | None:
        """The page and its content type; None if it cannot be rendered."""
        return self._pages.get(accept)

    def count_served(self) -> None:
        with self._changed:
            self.served += 1

    # ------------------------------------------------------------ the thread that accepts clients

    def _serve(self) -> None:
        while not self._end.is_set():
            self.timeout = self._drop_late()
            self.handle_request()

    def _drop_late(self) -> float | None:
        """Drop the clients whose time is over. Seconds to the next one; None if there is none."""
        with self._changed:
            now = time.monotonic()
            for client, until in self._clients.items():
                if until <= now:
                    self._drop(client)
            soonest = min(self._clients.values(), default=math.inf)
        return None if soonest == math.inf else soonest - now

    def server_bind(self) -> None:
        if self.address_family == socket.AF_INET6:
            self.socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        super().server_bind()

    def get_request(self) -> tuple[socket.socket, Any]:
        try:
            return super().get_request()
        except OSError as error:
            # The listener stays ready, so without a pause this would use a core.
            if not isinstance(error, ConnectionError) and not self._end.is_set():
                logger.warning("a client could not be accepted: %s", error)
                self._end.wait(RETRY_S)
            raise

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve it in a thread. Not `ThreadingMixIn`'s: that starts any number, without names."""
        thread = threading.Thread(
            target=self.process_request_thread, args=(request, client_address), name="phm-scrape", daemon=True
        )
        if not self._admit(request) or not threads.start_now(thread):
            self.dropped += 1
            self.shutdown_request(request)

    def _admit(self, client: socket.socket) -> bool:
        """Take a place, if needed that of the oldest. False if its thread does not end: it waits for a page that is not done."""
        with self._changed:
            if len(self._clients) >= MAX_CLIENTS:
                self._drop(min(self._clients, key=self._clients.__getitem__))
                if not self._changed.wait_for(lambda: len(self._clients) < MAX_CLIENTS, DROP_LIMIT_S):
                    return False
            self._clients[client] = time.monotonic() + CLIENT_S
        return True

    def _drop(self, client: socket.socket) -> None:
        """End its connection: its thread stops to read or write, and ends. The caller holds the lock."""
        if self._clients[client] != math.inf:
            self._clients[client] = math.inf
            self.dropped += 1
        with contextlib.suppress(OSError):
            client.shutdown(socket.SHUT_RDWR)

    # ------------------------------------------------------------ a client's thread

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        with self._changed:
            if self._clients.pop(request, None) is not None:
                self._changed.notify_all()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Whatever one client does, the others are served."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):  # else the client is gone
            logger.error("a client could not be served", exc_info=error)


class _Pages:
    """The newest page of each format."""

    def __init__(self, render: Render, accepts: Callable[[str], bool], clock: Clock) -> None:
        self._render, self._accepts, self._clock = render, accepts, clock
        self._lock = threading.Lock()
        self._kept: dict[bool, tuple[float, tuple[bytes, str] | None]] = {}
        """When each was made; None: it could not be."""

    def get(self, accept: str) -> tuple[bytes, str] | None:
        first = self._accepts(accept)
        with self._lock:
            kept = self._kept.get(first)
            if kept is None or self._clock.mono() - kept[0] >= AGAIN_S:
                page = self._made(accept)
                # The time is that of the end: what takes long is not done all the time.
                kept = self._kept[first] = (self._clock.mono(), page)
            return kept[1]

    def _made(self, accept: str) -> tuple[bytes, str] | None:
        try:
            return self._render(accept)
        except Exception:  # a failure must not end the server, and its text is not for clients
            logger.exception("the metrics could not be rendered")
            return None


class _Head(io.BufferedReader):
    """The lines of a request. `http.server` alone reads 100 of 64 KiB each."""

    _left = MAX_HEAD

    def readline(self, size: int | None = -1, /) -> bytes:
        line = super().readline(self._left + 1)
        self._left -= len(line)
        if self._left < 0:
            raise LineTooLong("request")
        if not line.endswith(b"\n"):
            raise ConnectionAbortedError("the client ended within its request")
        return line


class _Request(BaseHTTPRequestHandler):
    """One request; the connection is closed after it, as HTTP/1.0 does."""

    server: ScrapeServer
    rbufsize = 0  # so that rfile is a raw stream; _Head has the buffer
    default_request_version = "HTTP/1.0"  # a refused line of other protocols gets a status line, too
    error_message_format = "%(explain)s\n"
    error_content_type = "text/plain; charset=utf-8"
    # What BaseHTTPRequestHandler sets only once it has read the first line.
    command = requestline = ""
    request_version = "HTTP/1.0"

    def setup(self) -> None:
        super().setup()
        self.rfile = _Head(self.rfile)

    def handle(self) -> None:
        try:
            super().handle()
        except LineTooLong:  # the first line; the base class handles that of others
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)

    def parse_request(self) -> bool:
        """Refuse HTTP/0.9 and empty lines, too."""
        parsed = super().parse_request()
        if (parsed or not self.requestline) and len(self.requestline.split(" ")) != 3:
            self.send_error(HTTPStatus.BAD_REQUEST, explain="this is not an HTTP request")
            return False
        return parsed

    def do_GET(self) -> None:
        if not self._is_for_here():
            return
        if self.path.partition("?")[0] != "/metrics":
            self.send_error(HTTPStatus.NOT_FOUND, explain="only /metrics is served")
            return
        page = self.server.page(",".join(self.headers.get_all("Accept", ())))
        if page is None:
            self.send_error(HTTPStatus.INTERNAL_SERVER_ERROR, explain="the metrics cannot be shown: see PHM's log")
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", page[1])
        self.send_header("Content-Length", str(len(page[0])))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(page[0])
        self.server.count_served()

    do_HEAD = do_GET

    def do_POST(self) -> None:
        if self._is_for_here():
            self.send_error(HTTPStatus.METHOD_NOT_ALLOWED, explain="only GET is served")

    do_PUT = do_PATCH = do_DELETE = do_OPTIONS = do_POST

    def _is_for_here(self) -> bool:
        if self.server.local and not all(_is_local(host) for host in self.headers.get_all("Host", ())):
            self.send_error(HTTPStatus.FORBIDDEN, explain="the Host header names another machine")
            return False
        return True

    def send_response(self, code: int, message: str | None = None) -> None:
        super().send_response(code, message)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        if code == HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")

    def version_string(self) -> str:
        return "PHM"

    def log_message(self, format: str, *args: Any) -> None:
        """A client must not fill the log."""


def _is_local(host: str) -> bool:
    """Whether a header Host names this machine: on loopback, a web page of anywhere can have its own name point here."""
    name = host.partition("]")[0].strip("[") if host.startswith("[") else host.partition(":")[0]
    return name.lower() in ("localhost", "::1") or (name.startswith("127.") and name.replace(".", "").isdigit())
