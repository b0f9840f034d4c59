"""One run of the ROS child: start it, read its lines, measure its memory, end it, and report how it ended."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from typing import IO

from phm.core import threads
from phm.probes.ros.line_splitter import LineSplitter

_PIECE = 65536
_REAP_S = 2.0
_TAIL = 500
_PAGE = os.sysconf("SC_PAGE_SIZE")


class ChildProcess:
    """A started process. Owned by one thread, which must live as long as the process: the kernel's parent-death signal
    depends on the thread that started it.

    Invariant: after `end` the process is gone, except one that the kernel itself cannot end.
    """

    def __init__(self, command: Sequence[str], environ: Mapping[str, str], first_line: bytes) -> None:
        """Start `command` and send it `first_line`. Raises OSError if it cannot be started."""
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=dict(environ),
            start_new_session=True,  # Ctrl-C in the daemon's terminal is not for the child
            bufsize=0,
        )
        self._stderr: deque[bytes] = deque(maxlen=20)
        self._out = LineSplitter()
        self._err = LineSplitter()
        self._outgoing = b""
        self._selector = selectors.DefaultSelector()
        for pipe, lines in ((self._process.stdout, self._out), (self._process.stderr, self._err)):
            assert pipe is not None
            os.set_blocking(pipe.fileno(), False)
            self._selector.register(pipe, selectors.EVENT_READ, lines)
        self._write(first_line)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def over(self) -> bool:
        """It exited and all output is read, or it closed its output, which it does only by exiting."""
        return not any(key.data is self._out for key in self._selector.get_map().values())

    @property
    def writing(self) -> bool:
        """Whether the last line has not been completely written to the child."""
        return bool(self._outgoing)

    @property
    def dropped(self) -> int:
        """Number of output lines that were too long."""
        return self._out.dropped

    def send(self, line: bytes) -> None:
        """Queue one more line for the child; `read` writes it as the pipe has space. Not while `writing`."""
        assert not self._outgoing
        self._outgoing = line

    def read(self, timeout_s: float, wake_fd: int) -> list[bytes]:
        """Lines that arrive within `timeout_s`; returns early when `wake_fd` is readable. Also writes queued lines."""
        assert self._process.stdin is not None
        if wake_fd not in self._selector.get_map():
            self._selector.register(wake_fd, selectors.EVENT_READ)
        if self._outgoing:
            self._selector.register(self._process.stdin, selectors.EVENT_WRITE)
        try:
            ready = self._selector.select(timeout_s)
        finally:
            if self._outgoing:
                self._selector.unregister(self._process.stdin)
        lines: list[bytes] = []
        for key, events in ready:
            if events & selectors.EVENT_WRITE:
                self._write_some()
            if key.data is None:
                continue
            try:
                piece = os.read(key.fd, _PIECE)
            except BlockingIOError:
                continue
            if not piece:
                self._selector.unregister(key.fileobj)
            elif key.data is self._out:
                lines += self._out.add(piece)
            else:
                self._stderr.extend(line[:_TAIL] for line in self._err.add(piece))
        return lines

    def _write_some(self) -> None:
        assert self._process.stdin is not None
        try:
            self._outgoing = self._outgoing[os.write(self._process.stdin.fileno(), self._outgoing) :]
        except BlockingIOError:
            return
        except OSError:
            self._outgoing = b""  # it is gone: reading will detect that

    def rss_bytes(self) -> int:
        """Resident memory in bytes, shared pages included; 0 when the process is gone."""
        try:
            with open(f"/proc/{self.pid}/statm", encoding="ascii") as file:
                return int(file.read().split()[1]) * _PAGE
        except (OSError, IndexError, ValueError):
            return 0

    def end(self, grace_s: float) -> None:
        """Close its input, so that it exits; SIGKILL after `grace_s`. Safe to call twice."""
        self._close(self._process.stdin)
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            self._kill()
        self._selector.close()
        self._close(self._process.stdout)
        self._close(self._process.stderr)

    def exit_reason(self) -> str:
        """How it ended, with its last line on standard error. Call after `end`."""
        code = self._process.poll()
        if code is None:
            return f"was killed and has not ended: process {self.pid} hangs in the kernel, or the machine is too busy"
        text = f"was terminated by {_signal_name(-code)}" if code < 0 else f"exited with code {code}"
        tail = [line.decode("utf-8", "replace").strip() for line in self._stderr if line.strip()]
        return f"{text} ({tail[-1][:200]})" if tail else text

    @property
    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def _kill(self) -> None:
        self._process.kill()
        try:
            self._process.wait(_REAP_S)
        except subprocess.TimeoutExpired:  # `exit_reason` reports it; no zombie stays
            threads.start_now(threading.Thread(target=self._process.wait, name="phm-reap", daemon=True))

    def _write(self, data: bytes) -> None:
        """A configuration may be longer than a pipe holds, and the child may be dead already."""
        assert self._process.stdin is not None
        stdin = self._process.stdin.fileno()
        os.set_blocking(stdin, False)
        with selectors.DefaultSelector() as writable:
            writable.register(stdin, selectors.EVENT_WRITE)
            while data and writable.select(_REAP_S):
                try:
                    data = data[os.write(stdin, data) :]
                except BlockingIOError:
                    continue
                except OSError:
                    return  # it is gone: reading will detect that

    @staticmethod
    def _close(pipe: IO[bytes] | None) -> None:
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
