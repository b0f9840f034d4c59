"""A Docker Engine, or its proxy, that is reached by `tcp://NAME:PORT`."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from phm.transport.docker import DockerEngine, EngineNotConnected
from tests.fakes.until import until

LONG_S = 60.0


class Handler(BaseHTTPRequestHandler):
    """Answers each request like an engine that is asked for its version."""

    def do_GET(self) -> None:
        body = b'{"Version": "26.1", "ApiVersion": "1.45", "MinAPIVersion": "1.24"}'
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def port() -> Iterator[int]:
    """The port of an engine that listens on IPv4 alone."""
    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


Answers = Callable[..., list[Any]]


def answering(monkeypatch: pytest.MonkeyPatch, look_up: Answers) -> None:
    monkeypatch.setattr("phm.transport.dns.socket.getaddrinfo", look_up)


def both(host: str, port: int, *_: Any, **__: Any) -> list[Any]:
    """IPv6 first, as the resolver sorts them by default."""
    kind = socket.SOCK_STREAM
    v6, v4 = (socket.AF_INET6, kind, 6, "", ("::1", port, 0, 0)), (socket.AF_INET, kind, 6, "", ("127.0.0.1", port))
    return [v6, v4]


def test_each_address_of_a_name_is_tried(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy may listen on IPv4 alone."""
    answering(monkeypatch, both)
    engine = DockerEngine(f"tcp://proxy:{port}", timeout_s=LONG_S)
    engine.version()
    engine.close()


def test_a_name_server_that_hangs_delays_no_request_to_a_known_address(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The address is looked up again meanwhile, for the next requests."""
    hanging, asked, release = threading.Event(), threading.Event(), threading.Event()

    def look_up(*arguments: Any, **more: Any) -> list[Any]:
        if hanging.is_set():
            asked.set()
            release.wait(LONG_S)
        return both(*arguments, **more)

    answering(monkeypatch, look_up)
    engine = DockerEngine(f"tcp://proxy:{port}", timeout_s=LONG_S)
    engine.version()
    hanging.set()
    try:
        until(asked.is_set, "a look-up that hangs", step=engine.version)
        engine.timeout_s = LONG_S / 2
        engine.version()
    finally:
        release.set()
        engine.close()


def test_an_engine_that_has_another_address_now_is_reached_by_the_same_call(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A proxy that was recreated: what was known is wrong, and the look-up has the new address."""
    kind, moved = socket.SOCK_STREAM, threading.Event()

    def look_up(host: str, port: int, *_: Any, **__: Any) -> list[Any]:
        address = "127.0.0.1" if moved.is_set() else "127.0.0.2"
        return [(socket.AF_INET, kind, 6, "", (address, port))]

    answering(monkeypatch, look_up)
    engine = DockerEngine(f"tcp://proxy:{port}", timeout_s=LONG_S)
    with pytest.raises(EngineNotConnected):
        engine.version()
    moved.set()
    engine.version()
    engine.close()
