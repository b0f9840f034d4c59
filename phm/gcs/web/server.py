"""Serves the page, its data and the stream of events: one HTTP server (aiohttp) in a thread with its own event loop.

The receiver of frames never waits for it: what is new is handed over by `call_soon_threadsafe`, and each client has a bounded
backlog (`phm.gcs.web.clients`).
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import logging
import pkgutil
import socket
import threading
from collections.abc import Callable, Sequence

from aiohttp import web

from phm.core import threads
from phm.gcs.web import routes
from phm.gcs.web.access import MAX_CONFIG_BODY, AccessControl, Handler
from phm.gcs.web.clients import POLL_S, Clients
from phm.gcs.web.connections import MAX_CONNECTIONS, Connections
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.server_keys import ACCESS, CLIENTS
from phm.gcs.web.site import Site

logger = logging.getLogger(__name__)

CLOSE_LIMIT_S = 3.0
KEEPALIVE_S = 30.0

AddRoutes = Callable[[Site], Sequence[web.RouteDef]]


def all_routes(site: Site) -> list[web.RouteDef]:
    """The routes of every module of `phm.gcs.web.routes`."""
    found: list[web.RouteDef] = []
    for module in pkgutil.iter_modules(routes.__path__):
        found += importlib.import_module(f"{routes.__name__}.{module.name}").routes(site)
    return found


class WebServer:
    """Listens once it is constructed. Raises OSError if it cannot. options: checked (`ListenOptions.check`)."""

    def __init__(self, site: Site, options: ListenOptions, add_routes: AddRoutes = all_routes) -> None:
        self._options = options
        family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
        host = "127.0.0.1" if options.host == "localhost" else options.host
        self._listener = socket.create_server((host, options.port), family=family, backlog=MAX_CONNECTIONS)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._connections = Connections(site.clock)
        access = AccessControl(options, self.address[1], site.clock)
        self.clients = Clients(site.clock, site.on_clients, access.lasts)
        self._app = web.Application(middlewares=[self._serve_one, access.middleware], client_max_size=MAX_CONFIG_BODY)
        self._app[ACCESS], self._app[CLIENTS] = access, self.clients
        self._app.on_response_prepare.append(access.headers)
        self._app.add_routes(add_routes(site))
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = threading.Event()
        self._wake: asyncio.Event | None = None
        self._thread = threading.Thread(target=self._run, name="phm-web", daemon=True)
        site.view.listen(self.send_live)

    @property
    def url(self) -> str:
        host = f"[{self.address[0]}]" if ":" in self.address[0] else self.address[0]
        return f"{'https' if self._options.tls else 'http'}://{host}:{self.address[1]}/"

    def start(self) -> None:
        threads.start(self._thread)

    def about(self) -> str:
        """A sentence with the server's address and its number of clients."""
        count, dropped = len(self.clients), self.clients.dropped
        lost = f", {dropped} disconnected because they did not read" if dropped else ""
        return f"page at {self.url}, {count} {'client' if count == 1 else 'clients'}{lost}"

    def send_live(self, number: int, data: bytes) -> None:
        """Send a message to the page. May be called by any thread."""
        self.send("/api/live", number, data)

    def send(self, path: str, number: int | None, data: bytes) -> None:
        """Send data to all clients of the stream with this path. May be called by any thread."""
        if self._loop is not None and len(self.clients):
            with contextlib.suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self.clients.send, path, number, data)

    def close(self) -> None:
        self._closing.set()
        loop, wake = self._loop, self._wake
        if loop is not None and wake is not None:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(wake.set)
        threads.join(self._thread, CLOSE_LIMIT_S)
        self._listener.close()

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        # The default loop of Windows cannot watch a listener that exists already.
        loop = asyncio.SelectorEventLoop()
        try:
            loop.run_until_complete(self._serve())
        except Exception:
            logger.exception("the page is no longer served")
        finally:
            loop.close()

    async def _serve(self) -> None:
        self._wake = asyncio.Event()
        runner = web.AppRunner(
            self._app, access_log=None, handle_signals=False, keepalive_timeout=KEEPALIVE_S, shutdown_timeout=0.5
        )
        await runner.setup()
        site = web.SockSite(runner, self._listener, ssl_context=self._options.tls, backlog=MAX_CONNECTIONS)
        await site.start()
        # Only now: before it, there are no clients.
        self._loop = asyncio.get_running_loop()
        try:
            while not self._closing.is_set():
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._wake.wait(), POLL_S)
                self.clients.prune()
                if runner.server is not None:
                    self._connections.prune(one.transport for one in runner.server.connections)
        finally:
            self.clients.close()
            await runner.cleanup()

    @web.middleware
    async def _serve_one(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        self._connections.served(request.transport)
        return await handler(request)
