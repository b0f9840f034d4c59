"""Reads serial ports that no other program reads, as the configuration says: when data, and matching lines, arrived.

Each port has its own thread, because opening one with a stuck driver can hang. A port that another program has open or has
locked is not opened, and it is released if one opens it later.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import threading
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from phm.core import threads
from phm.core.clock import Clock
from phm.facts import CannotTell, SerialFact
from phm.probes.serial_port_users import users as users_of
from phm.transport.serial_errors import keep_dtr

MOST_PORTS = 16
AGAIN_S = 2.0
"""Time between two attempts to open a port."""
USERS_S = 10.0
"""Time between two searches for other programs that use it."""
PAUSE_S = 0.1
"""Between two reads, so that a steady stream does not wake PHM for each byte. The kernel keeps 4 kB meanwhile."""
READ_BYTES = 4096
MAX_LINE = 512
"""A longer line is compared by its first part."""
CLOSE_S = 1.0

UsersOf = Callable[[str], tuple[str, ...]]


class SerialPorts:
    """A `phm.facts.SerialProbe`. Thread-safe."""

    def __init__(self, clock: Clock, place: Callable[[str], Path], users: UsersOf = users_of) -> None:
        """place: where PHM finds a path of the host, links followed. users: programs other than PHM that have a path open."""
        self._clock, self._place, self._users = clock, place, users
        self._readers: dict[tuple[str, int, str], _Reader] = {}
        self._lock = threading.Lock()
        self._closed = False

    def inspect(self, path: str, *, baud: int, line: str) -> SerialFact:
        key = (path, baud, line)
        with self._lock:
            reader = self._readers.get(key)
            if reader is None:
                if self._closed or len(self._readers) >= MOST_PORTS:
                    raise CannotTell(f"PHM reads no more than {MOST_PORTS} serial ports")
                reader = self._readers[key] = _Reader(self._clock, lambda: self._place(path), self._users, baud, line)
                reader.start()
        return reader.fact()

    def close(self) -> None:
        """Close all ports. Waits CLOSE_S for their threads together; one that hangs in a driver ends with the process."""
        with self._lock:
            self._closed = True
            readers = list(self._readers.values())
        for reader in readers:
            reader.stop()
        until_s = self._clock.mono() + CLOSE_S
        for reader in readers:
            reader.join(until_s - self._clock.mono())


class _Reader:
    """Reads one port in its own thread."""

    def __init__(self, clock: Clock, place: Callable[[], Path], users: UsersOf, baud: int, line: str) -> None:
        self._clock, self._place, self._users, self._baud = clock, place, users, baud
        self._lines = LineMatcher(line)
        self._lock = threading.Lock()
        self._problem = "it has not been opened yet"
        self._opened = 0.0
        self._data_at: float | None = None
        self._line_at: float | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="phm-serial", daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def stop(self) -> None:
        self._stopping.set()

    def join(self, timeout_s: float) -> None:
        threads.join(self._thread, timeout_s)

    def fact(self) -> SerialFact:
        with self._lock:
            if self._problem:
                return SerialFact(problem=self._problem)
            now = self._clock.mono()
            data_s, line_s = (None if at is None else now - at for at in (self._data_at, self._line_at))
            return SerialFact(now - self._opened, data_s, line_s)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._read_until_lost()
            except Exception as error:  # a driver, or pyserial, may raise anything: the next attempt may work
                self._fail(_reason(error))
            self._stopping.wait(AGAIN_S)

    def _read_until_lost(self) -> None:
        """Open the port and read it until it is lost, in use by another program, or PHM ends. Raises OSError."""
        path = str(self._place())
        if others := self._users(path):
            self._fail(f"in use by {', '.join(others)}: two readers take each other's data; remove 'max_age'")
            return
        port = _opened(path, self._baud)
        try:
            with self._lock:
                self._problem, self._opened = "", self._clock.mono()
                self._data_at = self._line_at = None
            self._lines.clear()
            self._follow(path, port.fileno())
        finally:
            with contextlib.suppress(Exception):  # the device may be gone, and pyserial raises various errors then
                port.close()

    def _follow(self, path: str, fd: int) -> None:
        next_search_s = self._clock.mono() + USERS_S
        while not self._stopping.wait(PAUSE_S):
            readable, _, _ = select.select([fd], [], [], 0.5)
            if readable:
                data = os.read(fd, READ_BYTES)
                if not data:
                    raise OSError(errno.ENODEV, "the device was disconnected")
                self._take(data)
            if self._clock.mono() < next_search_s:
                continue
            next_search_s = self._clock.mono() + USERS_S
            if others := self._users(path):
                self._fail(f"now in use by {', '.join(others)}: PHM has closed it; remove 'max_age'")
                return

    def _take(self, data: bytes) -> None:
        matched = self._lines.add(data)
        with self._lock:
            self._data_at = self._clock.mono()
            if matched:
                self._line_at = self._data_at

    def _fail(self, problem: str) -> None:
        with self._lock:
            self._problem = problem


class LineMatcher:
    """Finds matching lines in a stream of any bytes. Keeps at most MAX_LINE of an incomplete line."""

    def __init__(self, pattern: str) -> None:
        self._pattern = pattern
        self._rest = b""

    def clear(self) -> None:
        self._rest = b""

    def add(self, data: bytes) -> bool:
        """Whether one of the lines that end in `data` matches."""
        if not self._pattern:
            return False
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = rest[:MAX_LINE]
        return any(fnmatchcase(line[:MAX_LINE].decode("utf-8", "replace").strip(), self._pattern) for line in lines)


def _opened(path: str, baud: int) -> Any:
    """The port, raw and locked against other programs that lock. Raises OSError, or ValueError for a baud rate that the driver
    refuses."""
    # Imported here: an agent without these checks needs no pyserial.
    import serial

    port = serial.Serial(path, baud, timeout=0, exclusive=True)
    keep_dtr(port.fileno())
    return port


def _reason(error: Exception) -> str:
    """Why it cannot be read, in words."""
    number = getattr(error, "errno", None)
    if number in (errno.EAGAIN, errno.EBUSY) or "exclusively lock" in str(error):
        return "another program has locked it: two readers take each other's data; remove 'max_age'"
    if number in (errno.EACCES, errno.EPERM):
        return "PHM itself may not open it: give its container the device, and its user the device's group"
    return os.strerror(number).lower() if number else str(error)[:200]
