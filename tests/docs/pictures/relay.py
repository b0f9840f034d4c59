"""A TCP relay on loopback whose connections can become half-open, as after a reset of one side that the other has not seen."""

from __future__ import annotations

import contextlib
import socket
import threading

POLL_S = 0.1
READ_BYTES = 65535


class Relay:
    """Forwards each connection to a port of loopback. After `stall`, the present ones stay open and forward nothing; later ones do."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(POLL_S)
        self.port = int(self._listener.getsockname()[1])
        self._closing, self._stalled = threading.Event(), threading.Event()
        self._threads = [threading.Thread(target=self._accept, name="test-relay", daemon=True)]
        self._threads[0].start()

    def stall(self) -> None:
        """Stop forwarding on every connection that is open now."""
        self._stalled.set()
        self._stalled = threading.Event()

    def close(self) -> None:
        self._closing.set()
        for thread in list(self._threads):
            thread.join(60)
        self._listener.close()

    def _accept(self) -> None:
        while not self._closing.is_set():
            with contextlib.suppress(TimeoutError):
                near, _ = self._listener.accept()
                thread = threading.Thread(
                    target=self._serve, args=(near, self._stalled), name="test-relay-connection", daemon=True
                )
                self._threads.append(thread)
                thread.start()

    def _serve(self, near: socket.socket, stalled: threading.Event) -> None:
        with near, contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self._target), 60) as far:
            back = threading.Thread(
                target=self._forward, args=(far, near, stalled), name="test-relay-back", daemon=True
            )
            back.start()
            self._forward(near, far, stalled)
            back.join(60)

    def _forward(self, source: socket.socket, target: socket.socket, stalled: threading.Event) -> None:
        source.settimeout(POLL_S)
        with contextlib.suppress(OSError):
            while not self._closing.is_set():
                if stalled.is_set():
                    self._closing.wait(POLL_S)
                    continue
                with contextlib.suppress(TimeoutError):
                    if not (data := source.recv(READ_BYTES)):
                        break
                    target.sendall(data)
        with contextlib.suppress(OSError):
            target.shutdown(socket.SHUT_WR)
