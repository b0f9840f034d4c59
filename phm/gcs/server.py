"""Serves events to other programs: a snapshot, then every new event as a line of JSON, by plain TCP or by HTTP on one port.

A client that sends nothing for GREET_S gets the bare lines; a client that sends a GET gets them as the body. No client can delay
the station: one that does not read is dropped, and everything else has a deadline.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from dataclasses import dataclass

from phm.core import threads
from phm.core.clock import Clock
from phm.core.stream_server import run, serving
from phm.gcs.events import GcsEvent
from phm.gcs.station import GroundStation
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue

logger = logging.getLogger(__name__)

MAX_CLIENTS = 16
PER_HOST = 8
"""Clients of one other machine, so that none takes all places."""
GREET_S = 0.3
"""A client that has sent nothing for this long is not an HTTP client."""
REQUEST_S = 5.0
MAX_REQUEST = 8192
MAX_BACKLOG = 4_000_000
"""Bytes that may wait for one client: the snapshot of the largest swarm, and minutes of events."""
STUCK_S = 10.0
"""A client that reads nothing for this long while data waits for it is dropped."""
ALIVE_S = 5.0
SEND_BUFFER_BYTES = 65536
_POLL_S = 0.1
_LOOPBACK = ("127.0.0.1", "::1")
_NAMES = (b"localhost", b"127.0.0.1", b"::1", b"[::1]")
CLOSE_LIMIT_S = 2.0
_HEAD = "HTTP/1.1 {status}\r\nContent-Type: {type}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
_EVENTS, _TEXT = "application/x-ndjson", "text/plain"


class _Refused(Exception):
    """The request is refused: HTTP status and text of the answer."""

    def __init__(self, status: str, text: str) -> None:
        super().__init__(status)
        self.answer = (_HEAD.format(status=status, type=_TEXT) + text).encode("ascii")


@dataclass(slots=True, eq=False)
class _Client:
    """seen: number of the last event that was sent to it; None: it gets no events. moved: when it last took data, or none waited."""

    writer: asyncio.StreamWriter
    host: str
    moved: float
    seen: int | None = None
    written: int = 0
    taken: int = 0
    half: bool = False
    """It has closed its side; it may still read, or be gone."""

    @property
    def waiting(self) -> int:
        """Bytes that wait for it."""
        return self.writer.transport.get_write_buffer_size()

    def write(self, data: bytes) -> None:
        self.written += len(data)
        self.writer.write(data)

    def stuck(self, now: float) -> bool:
        """Whether too much waits for it, or for too long. To be called often."""
        taken = self.written - self.waiting
        if taken != self.taken or not self.waiting:
            self.taken, self.moved = taken, now
        return self.waiting > MAX_BACKLOG or now - self.moved > STUCK_S


class _Feed(SubscriberQueue):
    """A queue that wakes the server."""

    def __init__(self, clock: Clock, wake: Callable[[], None]) -> None:
        super().__init__(clock)
        self._wake = wake

    def put(self, item: QueuedEvent) -> bool:
        kept = super().put(item)
        self._wake()
        return kept


class GcsServer:
    """Listens from the start. Raises OSError when it cannot."""

    def __init__(self, host: str, port: int, station: GroundStation, clock: Clock) -> None:
        self._station, self._clock = station, clock
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._clients: set[_Client] = set()
        self._alive_at = clock.mono() + ALIVE_S
        self.dropped = 0
        """Clients that did not keep up."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = threading.Event()
        self._wanted = asyncio.Event()
        """Something is to be done: there are events, or the server closes."""
        self._thread = threading.Thread(target=lambda: run(self._serve()), name="phm-gcs-serve", daemon=True)
        self._feed = _Feed(clock, self._wake)
        station.subscribe(self._feed)

    def start(self) -> None:
        threads.start(self._thread)

    def about(self) -> str:
        """Its address and its clients."""
        return (
            f"served at {self.address[0]}:{self.address[1]} to {len(self._clients)}, {self.dropped} dropped as too slow"
        )

    def close(self) -> None:
        self._closing.set()
        self._wake()
        threads.join(self._thread, CLOSE_LIMIT_S)

    def _wake(self) -> None:
        """From any thread."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended
                self._loop.call_soon_threadsafe(self._wanted.set)

    # ------------------------------------------------------------ the thread

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        async with serving(self._listener, self._serve_client, MAX_REQUEST):
            while not self._closing.is_set():
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._wanted.wait(), _POLL_S)
                self._wanted.clear()
                try:
                    self._turn()
                except Exception:  # a failure with one client must not affect the others
                    logger.exception("serving events failed")

    def _turn(self) -> None:
        items = self._feed.take(0.0)
        now = self._clock.mono()
        if now >= self._alive_at:
            self._alive_at = now + ALIVE_S
            number, at = self._station.snapshot()[0], self._clock.stamp()
            self._broadcast(self._station.line(number, GcsEvent(at, "alive", {})))
        for item in items:
            self._broadcast(item.line, item.number)
        for client in tuple(self._clients):
            if client.stuck(now):
                self.dropped += 1
                self._drop(client)

    def _broadcast(self, line: bytes, number: int | None = None) -> None:
        """A line to all that listen; one with a number to those who do not have it yet."""
        for client in self._clients:
            if client.seen is not None and (number is None or number > client.seen):
                client.seen = client.seen if number is None else number
                client.write(line + b"\n")

    def _drop(self, client: _Client) -> None:
        self._clients.discard(client)
        client.writer.transport.abort()

    # ------------------------------------------------------------ one client

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        client = _Client(writer, writer.get_extra_info("peername")[0], self._clock.mono())
        try:
            self._admit(client)
            if await self._begin(client, reader):
                await _read_to_end(client, reader)
            else:
                writer.close()
            await writer.wait_closed()
        except _Refused as refusal:
            client.write(refusal.answer)
            writer.close()
            await writer.wait_closed()
        finally:
            self._drop(client)

    def _admit(self, client: _Client) -> None:
        neighbours = sum(other.host == client.host for other in self._clients)
        self._clients.add(client)
        if neighbours >= PER_HOST and client.host not in _LOOPBACK:
            raise _Refused("503 Service Unavailable", f"at most {PER_HOST} clients of one host are served\n")
        if len(self._clients) > MAX_CLIENTS:
            gone = next((other for other in self._clients if other.half), None)
            if gone is None:
                raise _Refused("503 Service Unavailable", f"at most {MAX_CLIENTS} clients are served\n")
            self._drop(gone)

    async def _begin(self, client: _Client, reader: asyncio.StreamReader) -> bool:
        """Send what it asks for, the snapshot first; whether it is to get events from now on."""
        request = await _request(reader)
        path = b"/" if request is None else self._path(request)
        number, event = self._station.snapshot()
        if request is not None:
            kind = _EVENTS if path == b"/" else "application/json"
            client.write(_HEAD.format(status="200 OK", type=kind).encode("ascii"))
        client.write(self._station.line(number, event) + b"\n")
        client.seen = number if path == b"/" else None
        return client.seen is not None

    def _path(self, request: bytes) -> bytes:
        """The path that an HTTP request is for: `/` or `/snapshot`. Raises _Refused."""
        words = request.partition(b"\n")[0].split()
        method, path = (words[0], words[1].partition(b"?")[0]) if len(words) == 3 else (b"", b"")
        if not self._named_rightly(request):
            raise _Refused("403 Forbidden", "ask for this machine by its own name or address\n")
        if method != b"GET":
            raise _Refused("405 Method Not Allowed", "only GET is served\n")
        if path not in (b"/", b"/news", b"/snapshot"):
            raise _Refused("404 Not Found", "there are / and /snapshot\n")
        return b"/" if path == b"/news" else path

    def _named_rightly(self, request: bytes) -> bool:
        """On loopback, a web page of anywhere can have its own name point here: then the Host header has that name."""
        if self.address[0] not in _LOOPBACK:
            return True
        hosts = [line[5:].strip() for line in request.splitlines() if line[:5].lower() == b"host:"]
        return all(host.rpartition(b":")[0].strip(b"[]") in _NAMES or host in _NAMES for host in hosts)


async def _request(reader: asyncio.StreamReader) -> bytes | None:
    """What an HTTP client asks, up to the empty line; None: it has asked nothing. Raises _Refused and ConnectionError."""
    try:
        request = await asyncio.wait_for(reader.read(MAX_REQUEST), GREET_S)
    except asyncio.TimeoutError:
        return None
    if not request:
        return None
    try:
        return await asyncio.wait_for(_head(reader, request), REQUEST_S)
    except asyncio.TimeoutError:
        raise _Refused("408 Request Timeout", "no complete request came\n") from None


async def _head(reader: asyncio.StreamReader, request: bytes) -> bytes:
    while b"\n\r\n" not in request and b"\n\n" not in request:
        if len(request) >= MAX_REQUEST:
            raise _Refused("431 Request Header Fields Too Large", "the request is too long\n")
        more = await reader.read(MAX_REQUEST)
        if not more:
            raise ConnectionError("the client has ended before its request")
        request += more
    return request


async def _read_to_end(client: _Client, reader: asyncio.StreamReader) -> None:
    """A client that has closed its side may still read; one that is gone shows when it is written to."""
    while await reader.read(MAX_REQUEST):
        pass
    client.half = True
