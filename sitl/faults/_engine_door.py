"""A door of our own before the Docker Engine's socket: closed, the engine is gone for one agent and for nobody else."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
from pathlib import Path

ENGINE = "/var/run/docker.sock"
CHUNK = 65536
TICK_S = 0.2
MOST = 64


class Door:
    """A unix socket at `path` that passes everything on to the engine while it is open. Threads: one to accept, one a connection."""

    def __init__(self, path: Path, engine: str = ENGINE) -> None:
        self.path, self._engine = path, engine
        self._ended = threading.Event()
        self._open = threading.Event()
        self._open.set()
        path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(path))
        path.chmod(
            0o666
        )  # as the engine's own socket is for its group, whose number in PHM's container need not be ours
        self._socket.listen(MOST)
        self._socket.settimeout(TICK_S)
        threading.Thread(target=self._accept, name="engine-door", daemon=True).start()

    def shut(self) -> None:
        """Cut all connections within a moment; new ones are cut as soon as they come, as by an engine that is not there."""
        self._open.clear()

    def open(self) -> None:
        self._open.set()

    def close(self) -> None:
        """End all threads and remove the socket. Doing it twice is harmless."""
        self._ended.set()
        self._socket.close()
        self.path.unlink(missing_ok=True)

    def _accept(self) -> None:
        while not self._ended.is_set():
            try:
                client, _ = self._socket.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            if self._open.is_set():
                threading.Thread(target=self._carry, args=(client,), name="engine-door-pass", daemon=True).start()
            else:
                client.close()

    def _carry(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as engine:
            engine.connect(self._engine)
            other = {client: engine, engine: client}
            while self._open.is_set() and not self._ended.is_set():
                for ready in select.select(list(other), [], [], TICK_S)[0]:
                    data = ready.recv(CHUNK)
                    if not data:
                        return
                    other[ready].sendall(data)
