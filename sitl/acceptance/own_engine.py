"""A Docker Engine of this program alone, which may be restarted: `dockerd` as a child, behind a socket that stays.

As with systemd's docker.socket, the socket belongs to its starter and is handed to each dockerd: clients that connect while none runs
wait, and what is mounted into containers stays valid. A dockerd that creates the socket itself leaves containers with the old file.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import time
from pathlib import Path

from docker import DockerClient
from docker.errors import DockerException

SOCKET = Path("/run/docker.sock")
START_LIMIT_S = 60.0
STOP_LIMIT_S = 60.0
HANDED_OVER = 'exec 3<&0 </dev/null; export LISTEN_FDS=1 LISTEN_PID=$$; exec dockerd --host fd:// "$@"'
"""Standard input is the socket; systemd's protocol has it as the file descriptor 3 of the process LISTEN_PID."""


class OwnEngine:
    """folder: its data and its log. Needs root and separate namespaces for mounts, network and processes (scripts/proof-engine)."""

    def __init__(self, folder: Path) -> None:
        if SOCKET.exists():
            raise RuntimeError(f"{SOCKET} exists: start this by scripts/proof-engine, beside the engine of the machine")
        self._folder = folder
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.bind(str(SOCKET))
        SOCKET.chmod(0o660)
        self._socket.listen()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, *, live_restore: bool) -> None:
        """Returns when it answers. Raises TimeoutError with the end of its log."""
        options = ["--data-root", str(self._folder / "root"), *(["--live-restore"] if live_restore else [])]
        with (self._folder / "dockerd.log").open("ab") as log:
            self._process = subprocess.Popen(
                ["sh", "-c", HANDED_OVER, "sh", *options],
                stdin=self._socket.fileno(),
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        until_s = time.monotonic() + START_LIMIT_S
        while not self._answers():
            if self._process.poll() is not None or time.monotonic() > until_s:
                lines = (self._folder / "dockerd.log").read_text("utf-8", "replace").splitlines()
                raise TimeoutError("dockerd did not start:\n" + "\n".join(lines[-15:]))
            time.sleep(0.2)

    def end(self, number: signal.Signals) -> None:
        """Send it the signal and wait for its end. SIGKILL also ends containerd, which is its child."""
        assert self._process is not None
        if number == signal.SIGKILL:
            for pid in _children(self._process.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
        self._process.send_signal(number)
        self._process.wait(STOP_LIMIT_S)

    @staticmethod
    def _answers() -> bool:
        try:
            client = DockerClient(f"unix://{SOCKET}", timeout=2)
            client.ping()
            client.close()
        except (DockerException, OSError):
            return False
        return True


def _children(pid: int) -> list[int]:
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text("ascii")
    return [int(word) for word in text.split()]
