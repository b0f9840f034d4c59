"""Other programs get a snapshot and then the events by HTTP; none of them can delay or fill the ground."""

from __future__ import annotations

import http.client
import json
import socket
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from phm.core.clock import SystemClock
from phm.gcs.web import stream
from phm.gcs.web.options import ListenOptions, Tokens, tls_context
from phm.gcs.web.server import WebServer
from tests.fakes.until import until
from tests.gcs.bench import Source
from tests.gcs.web.swarm import Client, ground

TOKEN = "operate-token-0123456789"


class Lines:
    """A client of the stream."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.sock = socket.create_connection(address, 30)
        self.sock.sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
        self.sock.settimeout(0.1)
        self.data, self.closed = b"", False

    def read(self) -> bytes:
        try:
            chunk = self.sock.recv(65536)
            self.closed, self.data = not chunk, self.data + chunk
        except TimeoutError:
            pass
        except ConnectionError:
            self.closed = True
        return self.data

    def events(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self.read().rpartition(b"\n")[0].splitlines() if line.startswith(b"{")]

    def news(self) -> list[int]:
        return [event["seq"] for event in self.events() if event["event"] == "said"]


@pytest.fixture
def source() -> Source:
    return Source()


def serving(source: Source, tokens: Tokens | None = None) -> WebServer:
    made = stream.serve(cast(Any, source), ListenOptions(port=0, tokens=tokens), SystemClock())
    made.start()
    until(lambda: made._loop, "the server")
    return made


@pytest.fixture
def server(source: Source) -> Iterator[WebServer]:
    made = serving(source)
    yield made
    made.close()


@pytest.fixture
def lines(server: WebServer) -> Iterator[Lines]:
    made = Lines(server.address)
    until(made.events, "the snapshot")
    yield made
    made.sock.close()


def test_a_client_gets_a_snapshot_and_then_the_events(source: Source, server: WebServer) -> None:
    """Without gaps or duplicates, whenever it connects."""
    for _ in range(5):
        source.say()
    client = Lines(server.address)
    until(client.events, "the snapshot")
    assert (client.events()[0]["event"], client.events()[0]["seq"]) == ("snapshot", 5)
    for _ in range(100):
        source.say()
    until(lambda: len(client.news()) == 100, "the news")
    assert client.news() == list(range(6, 106))
    assert b"application/x-ndjson" in client.data
    client.sock.close()


def test_there_is_one_snapshot_and_no_page(server: WebServer) -> None:
    """The port of `--serve` has what it always had."""
    client = Client(server.address)
    assert client.get("/snapshot")["event"] == "snapshot"
    for path in ("/api/state", "/api/session", "/static/index.html", "/x"):
        assert client.ask("GET", path)[0] == 404
    assert client.ask("POST", "/", {})[0] == 405


def test_a_stream_without_events_has_keepalives(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client can distinguish silence from a broken connection."""
    monkeypatch.setattr(stream, "ALIVE_S", 0.1)
    made = serving(source)
    client = Lines(made.address)
    until(lambda: [event for event in client.events() if event["event"] == "alive"], "a sign of life")
    client.sock.close()
    made.close()


def test_a_client_that_does_not_read_is_dropped(
    source: Source, server: WebServer, lines: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its backlog; the others get every line in the meantime."""
    monkeypatch.setattr("phm.gcs.web.clients.MAX_BACKLOG", 200_000)
    slow, said = Lines(server.address), 0
    until(slow.events, "its snapshot")

    def go_on() -> bool:
        nonlocal said
        for _ in range(50):
            said = source.say("x" * 2000)
        until(lambda: lines.news()[-1:] == [said], "all lines at the fast client")
        return server.clients.dropped > 0

    until(go_on, "the slow client to be dropped")
    assert lines.news() == list(range(1, said + 1))
    slow.sock.close()


def test_the_stream_ends_with_the_program(server: WebServer, lines: Lines) -> None:
    """Its clients see the end, and the port is free again."""
    server.close()
    until(lambda: lines.read() and lines.closed, "the end")
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(server.address, 5)


def test_with_a_token_file_the_stream_needs_one(source: Source) -> None:
    """By either role."""
    made = serving(source, Tokens("", TOKEN))
    client = Client(made.address)
    assert client.ask("GET", "/snapshot")[0] == 401
    client.token = TOKEN
    assert client.get("/snapshot")["event"] == "snapshot"
    made.close()


def test_the_page_is_served_by_https_alone_with_tls_files(tmp_path: Path) -> None:
    """The page by HTTPS: the cookie is sent over HTTPS alone, and plain HTTP gets nothing."""
    cert, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:prime256v1",
        "-nodes",
        "-days",
        "1",
    ]
    subject = ["-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1"]
    subprocess.run([*made, *subject, "-out", cert, "-keyout", key], check=True, capture_output=True)
    options = ListenOptions(port=0, tokens=Tokens("", TOKEN), tls=tls_context(str(cert), str(key)))
    with ground(options) as here:
        assert here.page.url.startswith("https://")
        client = Client(here.page.address, ssl.create_default_context(cafile=str(cert)))
        status, body, response = client.ask("POST", "/api/login", {"token": TOKEN})
        assert (status, body["role"]) == (200, "operate")
        assert "Secure" in response.headers["Set-Cookie"]
        client.keep(body, response)
        own = f"https://127.0.0.1:{here.page.address[1]}"
        silence = {"do": "silence", "agent": None, "for_s": 5}
        assert client.ask("POST", "/api/alarms", silence, {"Origin": own})[0] == 200
        assert client.ask("POST", "/api/alarms", silence, {"Origin": own.replace("https", "http")})[0] == 403
        with pytest.raises((OSError, http.client.HTTPException)):
            here.client().ask("GET", "/")
