"""The door before the engine's socket: what goes through it, and that it can be shut for one agent alone."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl.faults import _docker_proxy as door
from tests.fakes.until import until

LIMIT_S = 20.0


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Path]:
    """Something at a unix socket that says back what it is told."""
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


def asked(path: Path) -> bytes:
    """What comes back through the door; empty when it is shut."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(LIMIT_S)
        try:
            client.connect(str(path))
            client.sendall(b"ping")
            return client.recv(100)
        except OSError:
            return b""


def test_it_passes_on_and_can_be_shut_and_opened(tmp_path: Path, engine: Path) -> None:
    """Open: as if it were not there. Shut: connections are cut, new ones too. Then all is as before."""
    path = tmp_path / "door"
    made = door.Proxy(path, str(engine))
    thread = threading.Thread(target=made.serve)
    thread.start()
    with socket.socket(socket.AF_UNIX) as lasting:
        lasting.settimeout(LIMIT_S)
        lasting.connect(str(path))
        lasting.sendall(b"a")
        assert lasting.recv(1) == b"a"
        door.block(path, 600.0)
        assert lasting.recv(1) == b""
        assert asked(path) == b""
    door.block(path, 0.0)
    until(lambda: asked(path) == b"ping", "the door being open again")
    path.unlink()
    thread.join(LIMIT_S)
    assert not thread.is_alive()


def test_it_is_a_process_of_its_own_until_it_is_taken_down(tmp_path: Path) -> None:
    """Put up twice it is one; taken down nothing of it is left."""
    path = tmp_path / "door"
    door.start(path)
    pid = door._pid(path)
    door.start(path)
    assert door._pid(path) == pid > 0
    door.stop(path)
    os.waitpid(pid, 0)
    door.stop(path)
    assert list(tmp_path.iterdir()) == []
