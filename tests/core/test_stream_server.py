"""Clients of a listening socket: each is served by a separate task, and disconnected when that ends."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import os
import socket
import threading
from collections.abc import Iterator

import pytest

from phm.core import stream_server


class EchoServer:
    """Sends each line back; fails at `fail`."""

    def __init__(self, listener: socket.socket) -> None:
        self.loop: asyncio.AbstractEventLoop | None = None
        self._ended = asyncio.Event()
        self._ready = threading.Event()
        self.thread = threading.Thread(target=lambda: stream_server.run(self._serve(listener)), daemon=True)
        self.thread.start()
        assert self._ready.wait(60)

    async def _serve(self, listener: socket.socket) -> None:
        self.loop = asyncio.get_running_loop()
        async with stream_server.serving(listener, self._echo, 100):
            self._ready.set()
            await self._ended.wait()

    async def _echo(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while line := await reader.readline():
            if line == b"fail\n":
                raise ZeroDivisionError
            writer.write(line)

    def close(self) -> None:
        assert self.loop is not None
        if self.thread.is_alive():
            self.loop.call_soon_threadsafe(self._ended.set)
        self.thread.join(60)
        assert not self.thread.is_alive()


class Listener(socket.socket):
    """A listening socket that can be out of file descriptors."""

    exhausted = 0

    def accept(self) -> tuple[socket.socket, object]:
        if self.exhausted:
            self.exhausted -= 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return super().accept()


@pytest.fixture
def listener() -> Listener:
    made = Listener(socket.AF_INET, socket.SOCK_STREAM)
    made.bind(("127.0.0.1", 0))
    made.listen(8)
    return made


@pytest.fixture
def server(listener: Listener) -> Iterator[EchoServer]:
    made = EchoServer(listener)
    yield made
    made.close()


def connect(address: object) -> socket.socket:
    assert isinstance(address, tuple)
    return socket.create_connection(address, 60)


def test_a_client_that_fails_is_disconnected_and_the_others_are_served(
    listener: Listener, server: EchoServer, caplog: pytest.LogCaptureFixture
) -> None:
    """The failure is logged."""
    address = listener.getsockname()
    with connect(address) as bad, connect(address) as good:
        bad.sendall(b"fail\n")
        assert bad.recv(10) == b""
        good.sendall(b"hello\n")
        assert good.recv(10) == b"hello\n"
    assert "could not be served" in caplog.text


def test_the_end_disconnects_all_clients(listener: Listener, server: EchoServer) -> None:
    """Those that are served, and one that has just connected; the port is free."""
    address = listener.getsockname()
    with connect(address) as served, connect(address) as new:
        served.sendall(b"hello\n")
        assert served.recv(10) == b"hello\n"
        server.close()
        assert served.recv(10) == b""
        with contextlib.suppress(ConnectionError):  # it may not have been accepted yet
            assert new.recv(10) == b""
    with pytest.raises(OSError):
        connect(address)


def test_clients_are_accepted_again_after_a_failure(
    listener: Listener, server: EchoServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as a lack of file descriptors."""
    monkeypatch.setattr(stream_server, "RETRY_S", 0.01)
    listener.exhausted = 3
    with connect(listener.getsockname()) as client:
        client.sendall(b"hello\n")
        assert client.recv(10) == b"hello\n"
    assert listener.exhausted == 0
