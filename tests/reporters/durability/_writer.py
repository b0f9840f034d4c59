"""A process that writes the real log as fast as it can, and says which events it was promised to keep.

It is forked, so that hundreds of them can be killed in a minute. After each event that `LogReporter` has taken it sends the
event's number through a pipe; after each tick, at which it is armed, it sends the number of the newest event as kept.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import signal
import struct
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from phm.core.clock import SystemClock
from phm.core.model import Note
from phm.core.settings import LogSettings, Settings
from phm.reporters.log import LogReporter
from phm.wire import json_log
from tests.fakes.records import context
from tests.fakes.until import until

_WORD = struct.Struct("=cI")
EVENTS_PER_TICK = 20
PIPE_BYTES = 8192
"""How far it writes while the test does not read: all of a run must fit into its files, however late the test is."""


class Writer:
    """written: events that were handed to the kernel; kept: those that were there at a completed tick while armed."""

    def __init__(self, directory: Path, run: int, *, max_size: int = 20_000, files: int = 50) -> None:
        """run: in the text of each event, to tell runs apart. max_size: of one file, so that rotations are frequent."""
        self.written = self.kept = 0
        self._rest = b""
        self._reader, writer = os.pipe()
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        os.set_blocking(self._reader, False)
        self.pid = os.fork()
        if not self.pid:
            os.close(self._reader)
            try:
                _write(directory, run, writer, max_size, files)
            except BaseException:
                traceback.print_exc()
            os._exit(1)
        os.close(writer)

    def read(self) -> None:
        """Take what the process has sent until now."""
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self._reader, 65536):
                self._rest += chunk
        used = len(self._rest) - len(self._rest) % _WORD.size
        for word, number in _WORD.iter_unpack(self._rest[:used]):
            if word == b"w":
                self.written = number
            else:
                self.kept = number
        self._rest = self._rest[used:]

    def until(self, wanted: Callable[[], bool]) -> None:
        """Read until `wanted`; at most a minute."""

        def seen() -> bool:
            assert not os.waitpid(self.pid, os.WNOHANG)[0], (self.written, self.kept)
            self.read()
            return wanted()

        until(seen, "the writer", lambda: (self.written, self.kept), limit_s=60.0, poll_s=0.001)

    def stop(self) -> None:
        """Suspend it: nothing is written from here."""
        os.kill(self.pid, signal.SIGSTOP)
        os.waitpid(self.pid, os.WUNTRACED)
        self.read()

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        self.read()
        os.close(self._reader)


@contextlib.contextmanager
def writer(directory: Path, run: int = 1, *, max_size: int = 20_000, files: int = 50) -> Iterator[Writer]:
    """A writer that is killed at the end."""
    made = Writer(directory, run, max_size=max_size, files=files)
    try:
        yield made
    finally:
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            made.kill()


def reporter(
    directory: Path, run: int, max_size: int, files: int, sync: Literal["auto", "always", "never"] = "auto"
) -> LogReporter:
    """The log of an armed agent."""
    settings = Settings(
        log=LogSettings(directory=str(directory), max_size=max_size, files=files, sync=sync),
        state_dir=str(directory / "state"),
    )
    made = replace(context(settings, clock=SystemClock()), reported_armed=lambda: True, boot_id=f"run{run:09d}")
    return LogReporter.build(made)


def _write(directory: Path, run: int, pipe: int, max_size: int, files: int) -> None:
    clock, log, number = SystemClock(), reporter(directory, run, max_size, files), 0
    while True:
        for _ in range(EVENTS_PER_TICK):
            number += 1
            log.handle(Note(clock.stamp(), "TEST", f"event {number} {'x' * (number % 300)}"))
            os.write(pipe, _WORD.pack(b"w", number))
        log.tick()
        if not log.problem():
            os.write(pipe, _WORD.pack(b"k", number))


def of_run(directory: Path, run: int) -> list[dict[str, Any]]:
    """The lines of a run, in the order of the files."""
    return [line for line in json_log.read(directory) if line["boot_id"] == f"run{run:09d}"]


def events_in(lines: list[dict[str, Any]]) -> list[int]:
    """The numbers of the events."""
    return [int(str(line["text"]).split()[1]) for line in lines if line["event"] == "note"]


def numbers_in(lines: list[dict[str, Any]]) -> list[int]:
    """All `seq`."""
    return [int(str(line["seq"])) for line in lines]


def events(directory: Path, run: int = 1) -> list[int]:
    """The numbers of a run's events, in the order of the files."""
    return events_in(of_run(directory, run))


def numbers(directory: Path, run: int = 1) -> list[int]:
    """All `seq` of a run."""
    return numbers_in(of_run(directory, run))
