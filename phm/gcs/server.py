"""Serves events to other programs: a snapshot, then every new event as a line of JSON, by plain TCP or by HTTP on one port.

A client that sends nothing for GREET_S gets the bare lines; a client that sends a GET gets them as the body. No client can delay
the station: one that does not read is dropped, and everything else has a deadline.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import threading
from dataclasses import dataclass, field

from phm.core import threads
from phm.core.clock import Clock
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


@dataclass(slots=True)
class _Client:
    """seen: number of the last event that was sent to it; None: it has not made a request. `ends`: close it when all is sent."""

    sock: socket.socket
    since: float
    moved: float
    host: str = ""
    asked: bytearray = field(default_factory=bytearray)
    pending: bytearray = field(default_factory=bytearray)
    seen: int | None = None
    ends: bool = False
    half: bool = False
    """It has closed its side; it may still read, or be gone."""


class _Feed(SubscriberQueue):
    """A queue that wakes the server's selector through a socket."""

    def __init__(self, clock: Clock, bell: socket.socket) -> None:
        super().__init__(clock)
        self._bell = bell

    def put(self, item: QueuedEvent) -> bool:
        kept = super().put(item)
        with contextlib.suppress(OSError):  # full: it rings already; closed: the server has ended
            self._bell.send(b"x")
        return kept


class GcsServer:
    """Listens from the start. Raises OSError when it cannot."""

    def __init__(self, host: str, port: int, station: GroundStation, clock: Clock) -> None:
        self._station, self._clock = station, clock
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._listener = socket.create_server((host, port), family=family, backlog=MAX_CLIENTS)
        self._listener.setblocking(False)
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        bell, self._bell = socket.socketpair()
        bell.setblocking(False)
        self._bell.setblocking(False)
        self._ringer, self._feed = bell, _Feed(clock, bell)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._bell, selectors.EVENT_READ)
        self._clients: dict[socket.socket, _Client] = {}
        self._alive_at = clock.mono() + ALIVE_S
        self.dropped = 0
        """Clients that did not keep up."""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="phm-gcs-serve", daemon=True)
        station.subscribe(self._feed)

    def start(self) -> None:
        threads.start(self._thread)

    def about(self) -> str:
        """Its address and its clients."""
        return (
            f"served at {self.address[0]}:{self.address[1]} to {len(self._clients)}, {self.dropped} dropped as too slow"
        )

    def close(self) -> None:
        self._stop.set()
        with contextlib.suppress(OSError):  # it rings already
            self._ringer.send(b"x")
        if self._thread.ident is not None:
            self._thread.join(CLOSE_LIMIT_S)

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        while not self._stop.is_set():
            try:
                self._turn()
            except Exception:  # a failure with one client must not affect the others
                logger.exception("serving events failed")
                self._clock.wait(self._stop, _POLL_S)
        for client in list(self._clients.values()):
            self._drop(client)
        self._selector.close()
        for sock in (self._listener, self._bell, self._ringer):
            sock.close()

    def _turn(self) -> None:
        for key, events in self._selector.select(_POLL_S):
            sock = key.fileobj
            assert isinstance(sock, socket.socket)
            if sock is self._listener:
                self._accept()
            elif sock is self._bell:
                with contextlib.suppress(BlockingIOError):
                    sock.recv(4096)
            elif (client := self._clients.get(sock)) is not None:
                if events & selectors.EVENT_READ:
                    self._receive(client)
                if events & selectors.EVENT_WRITE and sock in self._clients:
                    self._flush(client)
        items = self._feed.take(0.0)
        now = self._clock.mono()
        if now >= self._alive_at:
            self._alive_at = now + ALIVE_S
            number, at = self._station.snapshot()[0], self._clock.stamp()
            self._broadcast(self._station.line(number, GcsEvent(at, "alive", {})))
        for item in items:
            self._broadcast(item.line, item.number)
        for client in list(self._clients.values()):
            self._judge(client, now)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            sock, address = self._listener.accept()
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
            now = self._clock.mono()
            neighbours = sum(other.host == address[0] for other in self._clients.values())
            client = self._clients[sock] = _Client(sock, now, now, address[0])
            self._selector.register(sock, selectors.EVENT_READ)
            if neighbours >= PER_HOST and address[0] not in _LOOPBACK:
                self._answer(client, "503 Service Unavailable", f"at most {PER_HOST} clients of one host are served\n")
            elif len(self._clients) > MAX_CLIENTS and not self._make_room():
                self._answer(client, "503 Service Unavailable", f"at most {MAX_CLIENTS} clients are served\n")

    def _make_room(self) -> bool:
        gone = next((client for client in self._clients.values() if client.half), None)
        if gone is not None:
            self._drop(gone)
        return gone is not None

    def _receive(self, client: _Client) -> None:
        try:
            data = client.sock.recv(MAX_REQUEST)
        except BlockingIOError:
            return
        except OSError:
            self._drop(client)
            return
        if not data:
            # It has said all that it wants to say, and may still read: a client that is gone shows when it is written to.
            client.half = True
            self._listen(client)
            if client.seen is None and not client.ends:
                self._drop(client) if client.asked else self._begin(client)
            return
        if client.seen is not None or client.ends:
            return
        client.asked += data
        if b"\n\r\n" in client.asked or b"\n\n" in client.asked:
            self._asked(client)
        elif len(client.asked) >= MAX_REQUEST:
            self._answer(client, "431 Request Header Fields Too Large", "the request is too long\n")

    def _asked(self, client: _Client) -> None:
        words = bytes(client.asked.partition(b"\n")[0]).split()
        method, path = (words[0], words[1].partition(b"?")[0]) if len(words) == 3 else (b"", b"")
        if not self._named_rightly(client):
            self._answer(client, "403 Forbidden", "ask for this machine by its own name or address\n")
        elif method != b"GET":
            self._answer(client, "405 Method Not Allowed", "only GET is served\n")
        elif path in (b"/", b"/news"):
            client.pending += _HEAD.format(status="200 OK", type=_EVENTS).encode("ascii")
            self._begin(client)
        elif path == b"/snapshot":
            client.pending += _HEAD.format(status="200 OK", type="application/json").encode("ascii")
            self._begin(client)
            client.ends = True
        else:
            self._answer(client, "404 Not Found", "there are / and /snapshot\n")

    def _named_rightly(self, client: _Client) -> bool:
        """On loopback, a web page of anywhere can have its own name point here: then the Host header has that name."""
        if self.address[0] not in _LOOPBACK:
            return True
        hosts = [line[5:].strip() for line in bytes(client.asked).splitlines() if line[:5].lower() == b"host:"]
        return all(host.rpartition(b":")[0].strip(b"[]") in _NAMES or host in _NAMES for host in hosts)

    def _begin(self, client: _Client) -> None:
        number, event = self._station.snapshot()
        client.seen, client.moved = number, self._clock.mono()
        client.pending += self._station.line(number, event) + b"\n"
        self._flush(client)

    def _answer(self, client: _Client, status: str, text: str) -> None:
        client.pending += (_HEAD.format(status=status, type=_TEXT) + text).encode("ascii")
        client.ends, client.moved = True, self._clock.mono()
        self._flush(client)

    def _broadcast(self, line: bytes, number: int | None = None) -> None:
        """A line to all that listen; one with a number to those who do not have it yet."""
        for client in list(self._clients.values()):
            if client.seen is None or client.ends or (number is not None and number <= client.seen):
                continue
            client.seen = client.seen if number is None else number
            if not client.pending:
                client.moved = self._clock.mono()
            client.pending += line + b"\n"
            self._flush(client)

    def _judge(self, client: _Client, now: float) -> None:
        """Deadlines."""
        if client.pending and (len(client.pending) > MAX_BACKLOG or now - client.moved > STUCK_S):
            self.dropped += 1
            self._drop(client)
        elif client.ends and not client.pending:
            self._drop(client)
        elif client.seen is None and not client.ends:
            if not client.asked and now - client.since >= GREET_S:
                self._begin(client)
            elif now - client.since >= REQUEST_S:
                self._answer(client, "408 Request Timeout", "no complete request came\n")

    def _flush(self, client: _Client) -> None:
        try:
            while client.pending:
                sent = client.sock.send(memoryview(client.pending)[:SEND_BUFFER_BYTES])
                del client.pending[:sent]
                client.moved = self._clock.mono()
        except BlockingIOError:
            pass
        except OSError:
            self._drop(client)
            return
        self._listen(client)

    def _listen(self, client: _Client) -> None:
        """Wait for what the client can do next."""
        wanted = (0 if client.half else selectors.EVENT_READ) | (selectors.EVENT_WRITE if client.pending else 0)
        known = client.sock in self._selector.get_map()
        if not wanted and known:
            self._selector.unregister(client.sock)
        elif wanted and not known:
            self._selector.register(client.sock, wanted)
        elif wanted:
            self._selector.modify(client.sock, wanted)

    def _drop(self, client: _Client) -> None:
        if self._clients.pop(client.sock, None) is not None:
            if client.sock in self._selector.get_map():
                self._selector.unregister(client.sock)
            client.sock.close()
