"""The proxy in front of the Docker Engine's socket, which can be closed for one agent."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.faults import _docker_proxy
from tests.fakes.until import until

LIMIT_S = 60.0


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Path]:
    """An echo server on a Unix socket."""
    path = tmp_path / "engine"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()
        server.settimeout(0.1)
        ended = threading.Event()

        def echo(client: socket.socket) -> None:
            with client, contextlib.suppress(OSError):
                while data := client.recv(100):
                    client.sendall(data)

        def serve() -> None:
            while not ended.is_set():
                with contextlib.suppress(TimeoutError):
                    client, _ = server.accept()
                    threading.Thread(target=echo, args=(client,), daemon=True).start()

        thread = threading.Thread(target=serve)
        thread.start()
        yield path
        ended.set()
        thread.join()


def response(path: Path) -> bytes:
    """What the proxy returns; empty when it is closed."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(LIMIT_S)
        try:
            client.connect(str(path))
            client.sendall(b"ping")
            return client.recv(100)
        except OSError:
            return b""


def test_the_proxy_forwards_until_it_is_closed_and_reopened(tmp_path: Path, engine: Path) -> None:
    """Open: transparent. Closed: existing and new connections are cut. Reopened: as before."""
    path = tmp_path / "docker.sock"
    made = _docker_proxy.Proxy(path, str(engine))
    thread = threading.Thread(target=made.serve)
    thread.start()
    with socket.socket(socket.AF_UNIX) as lasting:
        lasting.settimeout(LIMIT_S)
        lasting.connect(str(path))
        lasting.sendall(b"a")
        assert lasting.recv(1) == b"a"
        _docker_proxy.block(path, 600.0)
        assert lasting.recv(1) == b""
        assert response(path) == b""
    _docker_proxy.block(path, 0.0)
    until(lambda: response(path) == b"ping", "an answer of the engine")
    path.unlink()
    thread.join(LIMIT_S)
    assert not thread.is_alive()


def test_the_proxy_is_a_separate_process_until_it_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting it twice gives one process; after removal nothing is left."""
    monkeypatch.setattr(_docker_proxy, "START_LIMIT_S", LIMIT_S)
    path = tmp_path / "docker.sock"
    _docker_proxy.start(path)
    pid = _docker_proxy._pid(path)
    _docker_proxy.start(path)
    assert _docker_proxy._pid(path) == pid > 0
    _docker_proxy.stop(path)
    os.waitpid(pid, 0)
    _docker_proxy.stop(path)
    assert list(tmp_path.iterdir()) == []
