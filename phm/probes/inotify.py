"""Reports changes of directory entries with the kernel's inotify, without polling.

It watches inodes, so PHM sees changes by the host or another container through its own, read-only mount of the
directory. Changes that inotify does not report (on a network mount by another machine, through a hard link in another
directory, in a directory that PHM may not read) are found by the checks' period.
"""

from __future__ import annotations

import contextlib
import ctypes
import logging
import os
import select
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from phm.core import threads
from phm.core.backoff import Backoff
from phm.core.clock import Clock, SystemClock

logger = logging.getLogger(__name__)

Notify = Callable[[], None]
Watch = Callable[[str, str], bool]
"""Watch the entry of this name, or of names by a pattern with `*` and `?`, in this directory. True if it was not
watched before: earlier observations may be old.
"""

MOST_DIRECTORIES = 128
MOST_NAMES = 256
"""Maximum number of names for which events of one directory are kept."""
UNUSED_S = 30.0
"""A name that was not looked at for this long makes room for a new one. Checks look at their names every few seconds; other names
come from links, which applications change."""
GATHER_S = 0.05
"""After each event further ones are collected for this long, so that a busy directory costs little."""
PACE_S, PACE_MAX_S, CALM_S = 0.1, 5.0, 10.0
"""At least PACE_S between two notifications of one listener, doubled each time up to PACE_MAX_S, until nothing changed
for CALM_S: a continuously written file does not keep its check busy. The last change is always reported."""

_ATTRIB, _CLOSE_WRITE, _MOVED, _CREATE, _DELETE = 0x4, 0x8, 0x40 | 0x80, 0x100, 0x200
_DELETE_SELF, _MOVE_SELF, _UNMOUNT, _OVERFLOW, _IGNORED = 0x400, 0x800, 0x2000, 0x4000, 0x8000
_ONLY_DIRECTORIES = 0x01000000
_COMING_AND_GOING = _ATTRIB | _MOVED | _CREATE | _DELETE | _DELETE_SELF | _MOVE_SELF | _ONLY_DIRECTORIES
_HEAD = struct.Struct("iIII")
_READ_BYTES = 65536


@dataclass(eq=False)
class _Listener:
    """The function to call, and the earliest time of the next call."""

    notify: Notify
    mask: int
    due: float | None = None
    pause: Backoff = field(default_factory=lambda: Backoff(PACE_S, PACE_MAX_S))
    last: float = float("-inf")


@dataclass(eq=False)
class _Name:
    """Who wants to know about a name, and when it was last looked at."""

    used_s: float
    listeners: list[_Listener] = field(default_factory=list)


@dataclass(eq=False)
class _Directory:
    """wanted: the name that was not looked at for the longest time comes first."""

    key: tuple[int, int]
    mask: int = 0
    wanted: dict[str, _Name] = field(default_factory=dict)

    def use(self, name: str, now_s: float) -> _Name | None:
        """The entry of this name, a new one if there is room for it; else None."""
        known = self.wanted.pop(name, None)
        if known is None and len(self.wanted) >= MOST_NAMES:
            oldest = next(iter(self.wanted))
            if now_s - self.wanted[oldest].used_s < UNUSED_S:
                return None
            del self.wanted[oldest]
        used = self.wanted[name] = known or _Name(now_s)
        used.used_s = now_s
        return used


class FileWatcher:
    """One inotify instance and one thread for all listeners, created with the first watched directory.

    Invariant: `_directories` and `_numbers` contain the same directories, and are read and written with `_lock` held.
    """

    def __init__(self, clock: Clock | None = None) -> None:
        self._clock = clock or SystemClock()
        self._lock = threading.Lock()
        self._libc: ctypes.CDLL | None = None
        self._descriptor = -1
        self._wakeup: tuple[int, int] | None = None
        self._directories: dict[int, _Directory] = {}
        self._numbers: dict[tuple[int, int], int] = {}
        self._listeners: list[_Listener] = []
        self._closed = False

    def on(self, notify: Notify, *, content: bool = False) -> Watch:
        """Return a function that adds watches for one listener.

        `notify` is called from the thread of this object. content: closing a written file counts as a change too. Do
        not use it for devices: opening and closing a device does not change it.
        """
        listener = _Listener(notify, _COMING_AND_GOING | (_CLOSE_WRITE if content else 0))
        self._listeners.append(listener)
        return lambda directory, name: self._watch(listener, directory, name)

    def close(self) -> None:
        with self._lock:
            self._closed = True
            if self._wakeup is not None:
                with contextlib.suppress(OSError):
                    os.write(self._wakeup[1], b"x")

    # ------------------------------------------------------------ what is watched

    def _watch(self, listener: _Listener, directory: str, name: str) -> bool:
        try:
            seen = os.stat(directory)
        except OSError:
            return False  # a directory above it is watched
        with self._lock:
            number = self._number((seen.st_dev, seen.st_ino), directory, listener.mask)
            if number is None:
                return False
            entry = self._directories[number].use(name, self._clock.mono())
            if entry is None or listener in entry.listeners:
                return False
            entry.listeners.append(listener)
            return True

    def _number(self, key: tuple[int, int], directory: str, mask: int) -> int | None:
        """The kernel's number for watching the directory; None if it cannot be watched."""
        number = self._numbers.get(key)
        known = self._directories[number] if number is not None else _Directory(key)
        if number is not None and known.mask | mask == known.mask:
            return number
        libc = self._start()
        if libc is None or (number is None and len(self._directories) >= MOST_DIRECTORIES):
            return None
        known.mask |= mask
        number = int(libc.inotify_add_watch(self._descriptor, os.fsencode(directory), known.mask))
        if number < 0:
            return None
        self._numbers[key], self._directories[number] = number, known
        return number

    def _start(self) -> ctypes.CDLL | None:
        if self._libc is not None or self._closed:
            return None if self._closed else self._libc
        try:
            libc = ctypes.CDLL(None, use_errno=True)
            descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        except (OSError, AttributeError):
            descriptor = -1
        if descriptor < 0:
            return None  # no inotify, or too many instances (fs.inotify.max_user_instances)
        self._libc, self._descriptor, self._wakeup = libc, descriptor, os.pipe()
        threads.start(threading.Thread(target=self._follow, name="phm-inotify", daemon=True))
        return libc

    # ------------------------------------------------------------ what happens

    def _follow(self) -> None:
        assert self._wakeup is not None
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        poll.register(self._wakeup[0], select.POLLIN)
        while not self._closed:
            poll.poll(self._patience_ms())
            if self._closed:
                break
            try:
                for listener in self._concerned():
                    self._happened(listener)
                self._notify_due()
            except Exception:  # a defect of a listener must not end the thread
                logger.exception("a change of a directory could not be delivered")
            self._clock.wait(threading.Event(), GATHER_S)
        for number in (self._descriptor, *self._wakeup):
            os.close(number)

    def _patience_ms(self) -> float | None:
        due = [listener.due for listener in self._listeners if listener.due is not None]
        return max(0.0, (min(due) - self._clock.mono()) * 1000) if due else None

    def _concerned(self) -> list[_Listener]:
        """The listeners of the pending events."""
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except BlockingIOError:
            return []
        found: dict[int, _Listener] = {}
        at = 0
        with self._lock:
            while at < len(data):
                number, mask, _, length = _HEAD.unpack_from(data, at)
                name = os.fsdecode(data[at + _HEAD.size : at + _HEAD.size + length].rstrip(b"\0"))
                at += _HEAD.size + length
                found.update((id(listener), listener) for listener in self._of(number, mask, name))
        return list(found.values())

    def _of(self, number: int, mask: int, name: str) -> list[_Listener]:
        if mask & _OVERFLOW:
            return list(self._listeners)
        directory = self._directories.get(number)
        if directory is None:
            return []
        everybody = [listener for entry in directory.wanted.values() for listener in entry.listeners]
        if mask & (_IGNORED | _MOVE_SELF | _UNMOUNT):
            # Its path now names another directory, or none: the next scan watches that.
            self._forget(number, directory, gone=bool(mask & _IGNORED))
            return everybody
        wanted = [
            listener
            for pattern, entry in directory.wanted.items()
            if pattern == name or (_is_pattern(pattern) and fnmatchcase(name, pattern))
            for listener in entry.listeners
        ]
        return [listener for listener in wanted if listener.mask & mask]

    def _forget(self, number: int, directory: _Directory, *, gone: bool) -> None:
        del self._directories[number]
        self._numbers.pop(directory.key, None)
        if not gone and self._libc is not None:
            self._libc.inotify_rm_watch(self._descriptor, number)

    # ------------------------------------------------------------ notifications

    def _happened(self, listener: _Listener) -> None:
        now = self._clock.mono()
        if now - listener.last > CALM_S:
            listener.pause.reset()
        if listener.due is None:
            listener.due = max(now, listener.last + listener.pause.pause_s)

    def _notify_due(self) -> None:
        now = self._clock.mono()
        for listener in self._listeners:
            if listener.due is None or listener.due > now:
                continue
            if now - listener.last <= CALM_S:
                listener.pause.next_s()
            listener.due, listener.last = None, now
            listener.notify()


def _is_pattern(name: str) -> bool:
    return "*" in name or "?" in name
