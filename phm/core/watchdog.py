"""Watches over the daemon from a process of its own: a daemon that stands still is let go on, or ended to be started anew.

Docker restarts what exits, not what hangs, and a process that is stopped (SIGSTOP) or whose interpreter is held by a library that
never returns cannot end itself. So the daemon's heart writes a byte a second into a pipe, and at its other end this file, run as
a program, counts its own looks, not seconds: where the whole container or machine was frozen, it was frozen, too.

That a signal has stopped the daemon the kernel tells (its state is T), so that is seen in a fraction of a second and no matter of
patience. A daemon that was let go on is told so, by a line on the guard's standard output: it cannot know by itself.

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
GLANCES = 4
"""Looks at the daemon's state in each look at its beat. Nearly all of a glance's cost is waking up, 0.1 to 0.2 ms."""
STOPPED_LOOKS = 2
"""Glances in a row that find it stopped, so for 0.25 to 0.5 s: whoever stops and continues it at once is let alone."""
SILENT_LOOKS = 12
"""A starved daemon beats late; one that has not beaten for so long does not beat at all."""
SWITCH = "PHM_GUARD"
"""`off` in the environment: no guard, for whoever stops PHM on purpose."""
TERMINAL = "terminal"
"""The guard's argument where PHM runs in a terminal: there the shell stops it (Ctrl-Z), and lets it go on."""


class DaemonWatchdog:
    """The daemon's end of the pipes. A guard that cannot be started, or has died, is no reason not to run: it is `problem`."""

    def __init__(self, command: tuple[str, ...] = (sys.executable, "-I", "-S", __file__)) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._wrote_at = float("-inf")
        self.problem = ""

    def start(self) -> None:
        if os.environ.get(SWITCH, "").lower() == "off":
            return
        command = (*self._command, TERMINAL) if os.isatty(0) else self._command
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, bufsize=0
            )
        except OSError as error:
            self.problem = f"the guard over PHM cannot be started: {error.strerror or error}"
            return
        assert process.stdin is not None and process.stdout is not None
        os.set_blocking(process.stdin.fileno(), False)
        os.set_blocking(process.stdout.fileno(), False)
        self._process = process

    def revive(self) -> None:
        """Start it again where it could not be started, or has died."""
        if self.problem and self._process is None:
            self.problem = ""
            self.start()

    def beat(self) -> bool:
        """Called often; tells the guard at most twice in LOOK_S. Never blocks. True when the guard has let PHM go on since."""
        process, now = self._process, time.monotonic()
        if process is None:
            return False
        assert process.stdin is not None and process.stdout is not None
        try:
            if now - self._wrote_at >= LOOK_S / 2:
                self._wrote_at = now
                process.stdin.write(b".")  # None when it is frozen for now; it counts its own looks
            return bool(process.stdout.read(256))
        except OSError:
            self.close()
            self.problem = "the guard over PHM has ended: nobody notices when PHM hangs as a whole"
            return False

    def close(self) -> None:
        """Let it go, before anything that may take long. Doing it twice is harmless."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                stream.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2 * LOOK_S)


def state_of(pid: int) -> str:
    """`R`, `S`, `T`, ... as /proc has it; empty when there is no such process."""
    with contextlib.suppress(OSError), open(f"/proc/{pid}/stat", "rb", buffering=0) as stat:
        return state_in(stat.fileno())
    return ""


def state_in(stat: int) -> str:
    """From a /proc/PID/stat that stays open: half of what opening it for each look would cost."""
    try:
        line = os.pread(stat, 256, 0)
        return chr(line[line.rindex(b")") + 2])
    except (OSError, ValueError, IndexError):
        return ""


def watch(
    pipe: int,
    pid: int,
    kill: Callable[[int, int], None] = os.kill,
    look_s: float = LOOK_S,
    *,
    tell: Callable[[], None] = lambda: None,
    left_alone: str = "t",
) -> None:
    """Until the pipe ends or the daemon `pid` had to be ended. `tell` is called before it is let go on.

    `left_alone`: states in which somebody else has it: `t`, a debugger; in a terminal `T`, too.
    """
    os.set_blocking(pipe, False)
    end = select.poll()
    end.register(pipe, 0)  # the end alone wakes: what was written is counted at the next look
    silent = stopped = glances = 0
    with contextlib.suppress(FileNotFoundError), open(f"/proc/{pid}/stat", "rb", buffering=0) as stat:
        while not end.poll(1000 * look_s / GLANCES):
            state = state_in(stat.fileno())
            stopped = stopped + 1 if state == "T" and state not in left_alone else 0
            if stopped >= STOPPED_LOOKS:
                _say(f"PHM (process {pid}) was stopped by a signal: it is let go on")
                tell()
                kill(pid, signal.SIGCONT)
                stopped = 0
            glances += 1
            if glances % GLANCES:
                continue
            if _beaten(pipe):
                silent = 0
            elif state not in tuple(left_alone):
                silent += 1
            if silent >= SILENT_LOOKS:
                _say(
                    f"PHM (process {pid}) has stood still for {silent * look_s:.0f} s: it is ended, to be started anew"
                )
                kill(pid, signal.SIGKILL)
                return


def _beaten(pipe: int) -> bool:
    try:
        return bool(os.read(pipe, 4096))
    except BlockingIOError:
        return False


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"phm guard: {text}\n".encode())


def _tell() -> None:
    """Never blocks: a pipe that nobody reads is full at some time."""
    with contextlib.suppress(OSError):
        os.write(1, b"+")


if __name__ == "__main__":
    os.set_blocking(1, False)
    watch(0, os.getppid(), tell=_tell, left_alone="tT" if TERMINAL in sys.argv[1:] else "t")
