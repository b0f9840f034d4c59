"""A proxy before the Docker Engine's socket: closed, the engine is unreachable for one agent alone.

``python -m sitl.faults._docker_proxy PATH`` listens at PATH and passes everything on. It is a separate process, so that the injector
a fault may end meanwhile. `PATH.shut` holds until when it is shut, in seconds since the epoch; `PATH.pid` its process id. It ends
when it gets a signal, or when its folder is gone.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import sys
import threading
import time
from pathlib import Path

ENGINE = "/var/run/docker.sock"
CHUNK = 65536
TICK_S = 0.2
MOST = 64
START_LIMIT_S = 10.0


class Proxy:
    """Threads: one to accept, one a connection."""

    def __init__(self, path: Path, engine: str = ENGINE) -> None:
        self._path, self._engine = path, engine
        path.unlink(missing_ok=True)
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(path))
        path.chmod(0o666)  # PHM's user in its container does not exist here
        self._socket.listen(MOST)
        self._socket.settimeout(TICK_S)

    def serve(self) -> None:
        """Until the socket's file is gone. While it is shut, connections are cut within a moment and new ones immediately."""
        with self._socket:
            while self._path.exists():
                with contextlib.suppress(TimeoutError):
                    client, _ = self._socket.accept()
                    if self._shut:
                        client.close()
                    else:
                        threading.Thread(target=self._carry, args=(client,), name="engine-door", daemon=True).start()

    @property
    def _shut(self) -> bool:
        try:
            return time.time() < float(beside(self._path, "shut").read_text("ascii"))
        except (OSError, ValueError):
            return False

    def _carry(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as engine:
            engine.connect(self._engine)
            other = {client: engine, engine: client}
            while not self._shut and self._path.exists():
                for ready in select.select(list(other), [], [], TICK_S)[0]:
                    data = ready.recv(CHUNK)
                    if not data:
                        return
                    other[ready].sendall(data)


def beside(path: Path, what: str) -> Path:
    return path.with_name(f"{path.name}.{what}")


def start(path: Path) -> None:
    """Start the door at `path` unless there is one. Raises TimeoutError when it does not come up."""
    if _pid(path):
        return
    path.unlink(missing_ok=True)
    root = Path(__file__).resolve().parents[2]
    argv = [sys.executable, "-m", __name__, str(path)]
    nowhere = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in (0, 1, 2)]
    os.posix_spawn(argv[0], argv, {**os.environ, "PYTHONPATH": str(root)}, file_actions=nowhere, setsid=True)
    until_s = time.monotonic() + START_LIMIT_S
    while not _pid(path):
        if time.monotonic() > until_s:
            raise TimeoutError(f"there is no door at {path} after {START_LIMIT_S:g} s")
        time.sleep(0.02)


def block(path: Path, seconds: float) -> None:
    """Shut it for this long, 0: open it."""
    beside(path, "shut").write_text(f"{time.time() + seconds}\n", "ascii")


def responds(path: Path) -> bool:
    """Whether the engine answers through it."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as client:
        client.settimeout(START_LIMIT_S / 10)
        client.connect(str(path))
        client.sendall(b"GET /_ping HTTP/1.0\r\n\r\n")
        return client.recv(CHUNK).startswith(b"HTTP/1.0 200")
    return False


def stop(path: Path) -> None:
    """End it and remove its files. Doing it twice is harmless."""
    pid = _pid(path)
    if pid:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGTERM)
    for file in (path, beside(path, "shut"), beside(path, "pid")):
        file.unlink(missing_ok=True)


def _pid(path: Path) -> int:
    """The door's process, 0 when there is none: the file may be older than the machine's start."""
    try:
        pid = int(beside(path, "pid").read_text("ascii"))
        words = Path(f"/proc/{pid}/cmdline").read_bytes()
    except (OSError, ValueError):
        return 0
    return pid if str(path).encode() in words.split(b"\0") else 0


def main(path: Path) -> None:
    door = Proxy(path)
    beside(path, "pid").write_text(f"{os.getpid()}\n", "ascii")
    door.serve()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
