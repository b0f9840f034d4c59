"""Clients of endless responses: each has a bounded backlog, and one that does not keep up is dropped and counted.

Everything here runs in the event loop.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator

from aiohttp import web

from phm.core.clock import Clock
from phm.gcs.web.access import HttpProblem
from phm.gcs.web.options import is_loopback

MAX_CLIENTS = 64
PER_HOST = 16
"""Clients of one other machine, so that none takes all places."""
MAX_BACKLOG = 4_000_000
"""Bytes that may wait for one client: the state of the largest swarm, and minutes of events."""
STUCK_S = 10.0
"""A client that reads nothing for this long while data waits for it is dropped."""
POLL_S = 0.5


class StreamClient:
    """One connected client. seen: number of the last message that it has received."""

    def __init__(self, request: web.Request, seen: int, now: float) -> None:
        self.request, self.seen = request, seen
        # Not a BoundedQueue: a client that misses a message is of no use, so it is dropped instead of the message; and what is
        # being sent counts too.
        self._waiting = bytearray()
        self.bytes = 0
        self.moved = now
        """When the client last read data, or no data waited for it."""
        self._ready = asyncio.Event()
        self.over = False

    @property
    def host(self) -> str:
        return self.request.remote or "?"

    def add(self, data: bytes) -> None:
        self._waiting += data
        self.bytes += len(data)
        self._ready.set()

    def end(self) -> None:
        """Make `run` return."""
        self.over = True
        self._ready.set()

    def drop(self) -> None:
        """Close the connection now."""
        self.end()
        if self.request.transport is not None:
            self.request.transport.abort()

    async def run(self, response: web.StreamResponse, clock: Clock) -> None:
        """Send what is added, until `end`. Raises ConnectionError."""
        while True:
            await self._ready.wait()
            self._ready.clear()
            data, self._waiting = bytes(self._waiting), bytearray()
            if data:
                await response.write(data)
            self.bytes -= len(data)
            self.moved = clock.mono()
            if self.over:
                return


class Clients:
    """All clients of one server. on_change: takes how many there are, and how many were dropped. lasts: whether the sender of a
    request is still logged in."""

    def __init__(
        self,
        clock: Clock,
        on_change: Callable[[int, int], None] | None = None,
        lasts: Callable[[web.Request], bool] = lambda request: True,
    ) -> None:
        self._clock, self._on_change, self._lasts = clock, on_change or (lambda count, dropped: None), lasts
        self._clients: set[StreamClient] = set()
        self.dropped = 0
        """Number of clients that were dropped because they did not keep up."""

    def __len__(self) -> int:
        return len(self._clients)

    @contextlib.contextmanager
    def admit(self, request: web.Request, seen: int) -> Iterator[StreamClient]:
        """A place for a client. Raises HttpProblem when there is none."""
        client = StreamClient(request, seen, self._clock.mono())
        neighbours = sum(other.host == client.host for other in self._clients)
        if len(self._clients) >= MAX_CLIENTS:
            raise HttpProblem(503, f"at most {MAX_CLIENTS} clients are served")
        if neighbours >= PER_HOST and not is_loopback(client.host):
            raise HttpProblem(503, f"at most {PER_HOST} clients of one host are served")
        self._clients.add(client)
        self._on_change(len(self._clients), self.dropped)
        try:
            yield client
        finally:
            self._clients.discard(client)
            self._on_change(len(self._clients), self.dropped)

    def send(self, kind: str, number: int | None, data: bytes) -> None:
        """To all clients of a kind (the path that they asked for) that do not have message `number` yet; None: to all."""
        for client in self._clients:
            if client.request.path == kind and (number is None or number > client.seen):
                client.seen = client.seen if number is None else number
                client.add(data)

    def prune(self) -> None:
        """Drop clients that do not keep up, and end those whose session has ended. To be called every POLL_S."""
        now = self._clock.mono()
        for client in tuple(self._clients):
            if not self._lasts(client.request):
                self._clients.discard(client)
                client.drop()
            elif not client.bytes:
                client.moved = now
            elif client.bytes > MAX_BACKLOG or now - client.moved > STUCK_S:
                self._clients.discard(client)
                self.dropped += 1
                client.drop()

    def close(self) -> None:
        for client in self._clients:
            client.end()
