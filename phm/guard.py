"""Watches over the daemon from a process of its own: a daemon that stands still is let go on, or ended to be started anew.

Docker restarts what exits, not what hangs, and a process that is stopped (SIGSTOP) or whose interpreter is held by a library that
never returns cannot end itself. So the daemon's heart writes a byte a second into a pipe, and at its other end this file, run as
a program, counts its own looks, not seconds: where the whole container or machine was frozen, it was frozen, too.

Standard library alone, started without site-packages: 8 MB, most of them shared.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable

LOOK_S = 1.0
STOPPED_LOOKS = 4
"""So long a daemon may be stopped by a signal; a shell's job control takes less."""
SILENT_LOOKS = 12
"""A starved daemon beats late; one that has not beaten for so long does not beat at all."""
SWITCH = "PHM_GUARD"
"""`off` in the environment: no guard, for whoever stops PHM on purpose."""


class Guard:
    """The daemon's end of the pipe. A guard that cannot be started, or has died, is no reason not to run: it is `problem`."""

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-I", "-S", __file__)) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._wrote_at = float("-inf")
        self.problem = ""

    def start(self) -> None:
        if os.environ.get(SWITCH, "").lower() == "off":
            return
        try:
            process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True, bufsize=0
            )
        except OSError as error:
            self.problem = f"the guard over PHM cannot be started: {error.strerror or error}"
            return
        assert process.stdin is not None
        os.set_blocking(process.stdin.fileno(), False)
        self._process = process

    def beat(self) -> None:
        """Called often; tells the guard at most once in LOOK_S. Never blocks."""
        process, now = self._process, time.monotonic()
        if process is None or now - self._wrote_at < LOOK_S / 2:
            return
        self._wrote_at = now
        assert process.stdin is not None
        try:
            process.stdin.write(b".")
        except BlockingIOError:
            return  # it is frozen for now; it counts its own looks
        except OSError:
            self.close()
            self.problem = "the guard over PHM has ended: nobody notices when PHM hangs as a whole"

    def close(self) -> None:
        """Let it go, before anything that may take long. Doing it twice is harmless."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2 * LOOK_S)


def state_of(pid: int) -> str:
    """`R`, `S`, `T`, ... as /proc has it; empty when there is no such process."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as stream:
            return stream.read().rpartition(b")")[2].split()[0].decode("ascii")
    except (OSError, IndexError):
        return ""


def watch(pipe: int, pid: int, kill: Callable[[int, int], None] = os.kill, look_s: float = LOOK_S) -> None:
    """Until the pipe ends or the daemon `pid` had to be ended."""
    silent = stopped = 0
    while True:
        ready, _, _ = select.select([pipe], [], [], look_s)
        if ready:
            if not os.read(pipe, 4096):
                return
            silent = stopped = 0
            continue
        state = state_of(pid)
        if state == "t":  # a debugger has it
            continue
        silent += 1
        stopped = stopped + 1 if state == "T" else 0
        if stopped >= STOPPED_LOOKS:
            _say(f"PHM (process {pid}) was stopped by a signal: it is let go on")
            kill(pid, signal.SIGCONT)
            stopped = 0
        if silent >= SILENT_LOOKS:
            _say(f"PHM (process {pid}) has stood still for {silent * look_s:.0f} s: it is ended, to be started anew")
            kill(pid, signal.SIGKILL)
            return


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"phm guard: {text}\n".encode())


if __name__ == "__main__":
    watch(0, os.getppid())
