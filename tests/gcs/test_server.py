"""Other programs get a snapshot and then the events, over TCP and HTTP; none of them can delay or fill the ground."""

from __future__ import annotations

import contextlib
import json
import socket
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.gcs.events import GcsEvent, encode
from phm.gcs.server import MAX_CLIENTS, MAX_REQUEST, PER_HOST, GcsServer
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from tests.fakes.until import until


class Source:
    """The part of a station that the server uses. Its snapshot is the number of the last event."""

    def __init__(self) -> None:
        self._queues: list[SubscriberQueue] = []
        self._number, self._clock = 0, SystemClock()

    def subscribe(self, queue: SubscriberQueue) -> None:
        self._queues.append(queue)

    def snapshot(self) -> tuple[int, GcsEvent]:
        return self._number, GcsEvent(self._clock.stamp(), "snapshot", {"agents": []})

    def line(self, number: int, news: GcsEvent) -> bytes:
        return encode(news, "run", number)

    def say(self, text: str = "x") -> int:
        self._number += 1
        news = GcsEvent(self._clock.stamp(), "said", {"text": text})
        for queue in self._queues:
            queue.put(QueuedEvent(self._number, news, self.line(self._number, news)))
        return self._number


class Client:
    """A TCP client; `lines` has the events so far."""

    def __init__(self, server: GcsServer, request: bytes = b"", *, window: int | None = None) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if window is not None:
            self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, window)
        self.sock.connect(server.address)
        self.sock.settimeout(0.1)
        self.data, self.closed = b"", False
        if request:
            self.sock.sendall(request)

    def read(self) -> bytes:
        try:
            chunk = self.sock.recv(65536)
            self.closed = not chunk
            self.data += chunk
        except TimeoutError:
            pass
        except ConnectionError:
            self.closed = True
        return self.data

    def events(self) -> list[dict[str, Any]]:
        lines = self.read().rpartition(b"\n")[0].splitlines()
        return [json.loads(line) for line in lines if line.startswith(b"{")]

    def news(self) -> list[int]:
        return [event["seq"] for event in self.events() if event["event"] == "said"]


@pytest.fixture
def source() -> Source:
    return Source()


Connect = Callable[..., Client]


@pytest.fixture
def connect(server: GcsServer) -> Iterator[Connect]:
    """Create clients, and close them at the end."""
    made: list[Client] = []

    def make(request: bytes = b"", *, window: int | None = None) -> Client:
        made.append(Client(server, request, window=window))
        return made[-1]

    yield make
    for client in made:
        client.sock.close()


@pytest.fixture
def server(source: Source) -> Iterator[GcsServer]:
    made = GcsServer("127.0.0.1", 0, source, SystemClock())  # type: ignore[arg-type]
    made.start()
    yield made
    made.close()


def url(server: GcsServer, path: str) -> str:
    return f"http://127.0.0.1:{server.address[1]}{path}"


def test_a_silent_client_gets_a_snapshot_and_then_the_events(
    server: GcsServer, connect: Connect, source: Source
) -> None:
    """Without gaps or duplicates, whenever it connects."""
    for _ in range(5):
        source.say()
    client = connect()
    until(client.events, "the snapshot")
    first = client.events()[0]
    assert (first["event"], first["seq"]) == ("snapshot", 5)
    for _ in range(100):
        source.say()
    until(lambda: len(client.news()) == 100, "the news")
    assert client.news() == list(range(6, 106))


def test_http_streams_the_same_lines(server: GcsServer, connect: Connect, source: Source) -> None:
    """A header, then the lines; also for a client that closes its sending side after the request."""
    client = connect(b"GET / HTTP/1.1\r\nHost: localhost:1\r\n\r\n")
    client.sock.shutdown(socket.SHUT_WR)
    until(client.events, "the snapshot")
    assert client.data.startswith(b"HTTP/1.1 200 OK\r\nContent-Type: application/x-ndjson\r\n")
    source.say()
    until(client.news, "the news")


def test_http_gives_one_snapshot(server: GcsServer) -> None:
    """And ends."""
    with urllib.request.urlopen(url(server, "/snapshot"), timeout=15) as answer:
        assert json.load(answer)["event"] == "snapshot"


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (b"GET /agents HTTP/1.1\r\n\r\n", b"404"),
        (b"POST / HTTP/1.1\r\n\r\n", b"405"),
        (b"\x16\x03\x01 nonsense\r\n\r\n", b"405"),
        (b"GET / HTTP/1.1\r\nHost: evil.example:80\r\n\r\n", b"403"),
        (b"x" * MAX_REQUEST, b"431"),
    ],
    ids=["path", "method", "nonsense", "another host", "too long"],
)
def test_an_unsupported_request_is_rejected(
    server: GcsServer, connect: Connect, request_: bytes, status: bytes
) -> None:
    """With a status that says why, and closed."""
    client = connect(request_)
    until(lambda: client.read() and client.closed, "the end")
    assert client.data.split()[1] == status
    assert server.about().endswith("to 0, 0 dropped as too slow")


def test_an_incomplete_request_has_a_deadline(
    server: GcsServer, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client cannot occupy a place by sending little."""
    monkeypatch.setattr("phm.gcs.server.REQUEST_S", 0.2)
    client = connect(b"GET / HT")
    until(lambda: client.read() and client.closed, "the end")
    assert b" 408 " in client.data


@pytest.mark.parametrize("limit", ["MAX_BACKLOG", "STUCK_S"])
def test_a_client_that_does_not_read_is_dropped(
    server: GcsServer, connect: Connect, source: Source, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    """By the size or the age of its backlog; the others get every line in the meantime."""
    monkeypatch.setattr(f"phm.gcs.server.{limit}", {"MAX_BACKLOG": 200_000, "STUCK_S": 0.3}[limit])
    slow, quick = connect(window=4096), connect()
    until(lambda: slow.events() and quick.events(), "both snapshots")
    said = 0

    def go_on() -> bool:
        nonlocal said
        for _ in range(50):
            said = source.say("x" * 2000)
        until(lambda: quick.news()[-1:] == [said], "all lines at the fast client")
        return server.dropped > 0

    until(go_on, "the slow client to be dropped")
    assert quick.news() == list(range(1, said + 1))
    assert server.dropped == 1


def test_too_many_clients_are_rejected(server: GcsServer, connect: Connect, source: Source) -> None:
    """Connected clients stay; a disconnected one makes room."""
    clients = [connect() for _ in range(MAX_CLIENTS)]
    for client in clients:
        until(client.events, "the snapshot")
    more = connect()
    until(lambda: more.read() and more.closed, "the refusal")
    assert b" 503 " in more.data
    clients[3].sock.close()
    until(lambda: _served(connect), "a place")
    source.say()
    for place, client in enumerate(clients):
        if place != 3:
            until(client.news, "the news")


def test_one_host_does_not_take_all_places(server: GcsServer, connect: Connect) -> None:
    """Idle connections of another machine leave room for the next one."""
    with contextlib.ExitStack() as stack:
        crowd = [
            stack.enter_context(socket.create_connection(server.address, source_address=("127.0.0.2", 0)))
            for _ in range(MAX_CLIENTS)
        ]
        until(lambda: server.about().endswith(f"to {PER_HOST}, 0 dropped as too slow"), "the others to be refused")
        assert b" 503 " in crowd[-1].recv(300)
        until(lambda: _served(connect), "a place for another host")


def _served(connect: Connect) -> bool:
    client = connect()
    until(client.read, "an answer")
    return client.data.startswith(b"{")


def test_a_stream_without_events_has_keepalives(
    server: GcsServer, connect: Connect, source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client can distinguish silence from a broken connection."""
    monkeypatch.setattr("phm.gcs.server.ALIVE_S", 0.1)
    server._alive_at = 0.0
    client = connect()
    until(lambda: [event for event in client.events() if event["event"] == "alive"], "a sign of life")


def test_the_server_ends_with_the_program(server: GcsServer, connect: Connect) -> None:
    """Its clients see the end, and the port is free again."""
    client = connect()
    until(client.events, "the snapshot")
    server.close()
    until(lambda: client.read() and client.closed, "the end")
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url(server, "/snapshot"), timeout=5)
