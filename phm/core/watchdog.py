"""Watch the daemon from a separate process: resume a daemon that was stopped, kill one that is unresponsive.

Docker restarts what exits, not what hangs, and a process that is stopped (SIGSTOP) or blocked in a library call cannot end
itself. So the daemon's main loop writes a byte a second into a pipe. This file, run as a program at the other end, counts its
own checks instead of seconds, so a freeze of the entire container or machine is not mistaken for a hang.

The kernel reports that a signal stopped the daemon (state T), which is noticed in a fraction of a second. A resumed daemon is
informed by a line on the watchdog's standard output, because it cannot know by itself.

Standard library only, started without site-packages: 8 MB, most of them shared.
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

POLL_S = 1.0
GLANCES = 4
"""Checks of the daemon's process state per check of its heartbeat. Each costs 0.1 to 0.2 ms, mostly for waking up."""
STOPPED_POLLS = 2
"""State checks in a row that find it stopped (0.25 to 0.5 s): a short stop and continue is ignored."""
SILENT_POLLS = 12
"""Heartbeat checks without a heartbeat until the daemon is killed. A starved daemon is late, but not by this much."""
SWITCH = "PHM_WATCHDOG"
"""`off` in the environment disables the watchdog, for those who stop PHM intentionally."""
TERMINAL = "terminal"
"""Argument for a PHM that runs in a terminal, where the shell stops (Ctrl-Z) and resumes it."""


class DaemonWatchdog:
    """The daemon's end of the pipes. If the watchdog cannot be started or has died, `problem` says so and PHM runs on."""

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
            self.problem = f"the watchdog cannot be started: {error.strerror or error}"
            return
        assert process.stdin is not None and process.stdout is not None
        os.set_blocking(process.stdin.fileno(), False)
        os.set_blocking(process.stdout.fileno(), False)
        self._process = process

    def start_again(self) -> None:
        """Start it again if it could not be started or has died."""
        if self.problem and self._process is None:
            self.problem = ""
            self.start()

    def heartbeat(self) -> bool:
        """Send a heartbeat, at most twice per POLL_S. Never blocks. True if the watchdog has resumed PHM since the last call."""
        process, now = self._process, time.monotonic()
        if process is None:
            return False
        assert process.stdin is not None and process.stdout is not None
        try:
            if now - self._wrote_at >= POLL_S / 2:
                self._wrote_at = now
                process.stdin.write(b".")  # None while the watchdog is suspended; it counts its own checks
            return bool(process.stdout.read(256))
        except OSError:
            self.close()
            self.problem = "the watchdog has exited: daemon hangs will no longer be detected"
            return False

    def close(self) -> None:
        """End the watchdog; call it before anything that may take long. Idempotent."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None and process.stdout is not None
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError):
                stream.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2 * POLL_S)


def state_in(stat: int) -> str:
    """The same from an open /proc/PID/stat, at half the cost."""
    try:
        line = os.pread(stat, 256, 0)
        return chr(line[line.rindex(b")") + 2])
    except (OSError, ValueError, IndexError):
        return ""


def watch(
    pipe: int,
    pid: int,
    kill: Callable[[int, int], None] = os.kill,
    poll_s: float = POLL_S,
    *,
    on_resume: Callable[[], None] = lambda: None,
    left_alone: str = "t",
) -> None:
    """Run until the pipe ends or the daemon `pid` was killed. `on_resume` is called before the daemon is resumed.

    `left_alone`: states in which another program controls it: `t`, a debugger; in a terminal `T`, too.
    """
    os.set_blocking(pipe, False)
    end = select.poll()
    end.register(pipe, 0)  # only the end of the pipe wakes it; heartbeats are counted at the next check
    silent = stopped = glances = 0
    with contextlib.suppress(FileNotFoundError), open(f"/proc/{pid}/stat", "rb", buffering=0) as stat:
        while not end.poll(1000 * poll_s / GLANCES):
            state = state_in(stat.fileno())
            stopped = stopped + 1 if state == "T" and state not in left_alone else 0
            if stopped >= STOPPED_POLLS:
                _say(f"PHM (process {pid}) was stopped by a signal; resuming it")
                on_resume()
                kill(pid, signal.SIGCONT)
                stopped = 0
            glances += 1
            if glances % GLANCES:
                continue
            if _beaten(pipe):
                silent = 0
            elif state not in tuple(left_alone):
                silent += 1
            if silent >= SILENT_POLLS:
                _say(
                    f"PHM (process {pid}) has been unresponsive for {silent * poll_s:.0f} s; killing it so that it restarts"
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
        os.write(2, f"phm watchdog: {text}\n".encode())


def _report_resume() -> None:
    """Inform the daemon through standard output. Never blocks, even if the pipe is full."""
    with contextlib.suppress(OSError):
        os.write(1, b"+")


if __name__ == "__main__":
    os.set_blocking(1, False)
    watch(0, os.getppid(), on_resume=_report_resume, left_alone="tT" if TERMINAL in sys.argv[1:] else "t")
