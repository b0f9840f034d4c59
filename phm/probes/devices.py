"""Looks at device files of the host, through the mount of the host's /dev in PHM's container.

A path such as /dev/ttyACM0 is read at `dev_root`/ttyACM0. Links such as those of /dev/serial/by-id are followed within
that tree, because their targets are paths of the host.
"""

from __future__ import annotations

import errno
import os
import stat
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath

from serial.tools.list_ports_linux import SysFS

from phm.core.clock import Clock
from phm.core.settings import HostSettings
from phm.facts import CannotTell, DeviceFact
from phm.probes.blocking_call import BlockingCallWorker
from phm.probes.inotify import FileWatcher

INSPECT_S = 1.5
"""Deadline of looking at a device, and of opening it; opening one with a stuck driver can hang."""
MOST_OPENED = 64
"""So many devices are each opened in their own thread; further ones in the thread that looks at all."""
DESCRIPTION_S = 10.0
"""How long the description of a port is cached."""
_MOST_DESCRIPTIONS = 64
_MOST_LINKS = 16
_DEV = PurePosixPath("/dev")
_PORTS = ("ttyUSB*", "ttyACM*", "ttyAMA*", "ttyTHS*", "rfcomm*", "ttyS*")
_OPENING = os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC

# What an error while opening says about the device. False: unusable. True: it works, but another program
# uses it. None: nothing, because PHM has no permission.
_ERRORS: dict[int, tuple[bool | None, str]] = {
    errno.EBUSY: (True, "in use"),
    errno.EPERM: (None, "the device rules of PHM's own container do not allow opening it"),
    errno.EACCES: (None, "PHM itself may not open it"),
    errno.EROFS: (None, "PHM sees it through a read-only mount"),
    errno.ENXIO: (False, "no driver or device answers behind it"),
    errno.ENODEV: (False, "no driver or device answers behind it"),
    errno.EIO: (False, "the device answers with an input/output error"),
}


class Devices:
    """A `phm.facts.DeviceProbe`. Thread-safe; one call at a time.

    changed: called when a device that was looked at, or a link on the path to it, may have appeared, disappeared or
    changed. matching_changed: the same for the patterns of `matching`.
    """

    def __init__(
        self,
        settings: HostSettings,
        clock: Clock,
        watcher: FileWatcher | None = None,
        changed: Callable[[], None] = lambda: None,
        matching_changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._changed, self._matching_changed = changed, matching_changed
        self._watch = watcher.on(changed) if watcher is not None else lambda directory, name: False
        self._watch_pattern = watcher.on(matching_changed) if watcher is not None else lambda directory, name: False
        self._root = Path(settings.dev_root)
        self._clock = clock
        self._worker = BlockingCallWorker("devices")
        self._openers: dict[Path, BlockingCallWorker] = {}
        """Of each opened device: one that hangs must not hide the others."""
        self._opening, self._lock = threading.Lock(), threading.Lock()
        self._described: dict[str, tuple[float, str]] = {}

    def close(self) -> None:
        """End the threads; later calls raise CannotTell."""
        self._worker.close()
        with self._opening:
            for opener in self._openers.values():
                opener.close()

    def inspect(self, path: str, *, open_it: bool) -> DeviceFact | None:
        """The device at the host's `path`; the fact's path is the real one, with links followed."""
        fact = self._worker.call(lambda: self._inspect_and_watch(path), INSPECT_S)
        if fact is None or not open_it or not fact.character or fact.openable is False:
            return fact
        place = self._place(PurePosixPath(fact.path))
        openable, reason = self._opener(place).call(lambda: _opened(place), INSPECT_S)
        return None if reason == _GONE else replace(fact, openable=openable, reason=reason)

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        return self._worker.call(self._serial_ports, INSPECT_S)

    def matching(self, patterns: Sequence[str], *, without: Sequence[str] = ()) -> tuple[DeviceFact, ...]:
        return self._worker.call(lambda: self._matching(patterns, without), INSPECT_S)

    def place(self, path: str) -> Path:
        """Where PHM finds the device at the host's `path`, links followed as on the host. Raises FileNotFoundError."""
        real = self._resolve(PurePosixPath(os.path.normpath(path)), [])
        if real is None:
            raise FileNotFoundError(errno.ENOENT, "it does not exist", path)
        return self._place(real)

    def _opener(self, place: Path) -> BlockingCallWorker:
        with self._opening:
            if place not in self._openers and len(self._openers) >= MOST_OPENED:
                return self._worker
            return self._openers.setdefault(place, BlockingCallWorker(f"open-{place.name}"))

    def _matching(self, patterns: Sequence[str], without: Sequence[str]) -> tuple[DeviceFact, ...]:
        self._check_root()
        fresh = [self._watch_folders(PurePosixPath(pattern)) for pattern in (*patterns, *without)]
        if any(fresh):
            self._matching_changed()  # it may have changed between the start of the watch and an earlier inspection
        found: list[DeviceFact] = []
        for path in sorted(self._real_paths(patterns) - self._real_paths(without)):
            fact = self._inspect(path)
            if fact is not None and (fact.character or fact.block):
                found.append(fact)
            if len(found) == DeviceFact.MAX_MATCHES:
                break
        return tuple(found)

    def _real_paths(self, patterns: Sequence[str]) -> set[str]:
        """Host paths of what matches, links followed."""
        found: set[PurePosixPath | None] = set()
        for pattern in map(PurePosixPath, patterns):
            names = _names(self._place(pattern.parent))
            found |= {self._resolve(pattern.parent / name, []) for name in names if fnmatchcase(name, pattern.name)}
        return {str(path) for path in found if path is not None}

    def _watch_folders(self, pattern: PurePosixPath) -> bool:
        """Watch the pattern in its folder, and each folder on the path to it. True if something was not watched before."""
        steps = [step for step in (pattern, *pattern.parents) if step != _DEV and step.is_relative_to(_DEV)]
        return sum(self._watch_pattern(str(self._place(step.parent)), step.name) for step in steps) > 0

    def _check_root(self) -> None:
        if not self._root.is_dir():
            raise CannotTell(
                f"the host's /dev is not at {self._root}: mount it there, read-only, or correct host.dev_root"
            )

    def _inspect_and_watch(self, path: str) -> DeviceFact | None:
        steps: list[PurePosixPath] = []
        fact = self._inspect(path, steps)
        fresh = [self._watch(str(self._place(step.parent)), step.name) for step in steps]
        if any(fresh):
            self._changed()  # it may have changed between the inspection and the start of the watch
        return fact

    def _inspect(self, path: str, steps: list[PurePosixPath] | None = None) -> DeviceFact | None:
        """The device, without opening it; each step of the path to it is added to `steps`."""
        self._check_root()
        real = self._resolve(PurePosixPath(os.path.normpath(path)), [] if steps is None else steps)
        if real is None:
            return None
        place = self._place(real)
        try:
            seen = os.stat(place)
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            raise CannotTell(f"{path} cannot be inspected: {error.strerror or error}") from error
        if not stat.S_ISCHR(seen.st_mode):
            return DeviceFact(
                str(real), False, 0, 0, None, reason=_kind(seen.st_mode), block=stat.S_ISBLK(seen.st_mode)
            )
        openable: bool | None = None
        reason = "" if os.access(place, os.R_OK | os.W_OK) else "PHM itself may not open it"
        if not seen.st_mode & 0o666:
            openable, reason = False, "its mode allows no user to read or write"
        major, minor = os.major(seen.st_rdev), os.minor(seen.st_rdev)
        return DeviceFact(str(real), True, major, minor, openable, reason, self._describe(real.name), seen.st_ino)

    def _place(self, path: PurePosixPath) -> Path:
        """The path at which PHM finds a path of the host: below `dev_root` for /dev, otherwise the same."""
        return self._root / path.relative_to(_DEV) if path.is_relative_to(_DEV) else Path(path)

    def _resolve(self, path: PurePosixPath, steps: list[PurePosixPath]) -> PurePosixPath | None:
        """The host's path with links followed as on the host; None for a dangling or endless chain."""
        parts, done, links = list(path.parts[1:]), PurePosixPath("/"), 0
        while parts:
            step = os.path.normpath(done / parts.pop(0))
            done = PurePosixPath(step)
            if done == _DEV or not done.is_relative_to(_DEV):
                continue  # /dev itself is the mount; PHM must not follow links out of it
            steps.append(done)
            try:
                target = os.readlink(self._place(done))
            except FileNotFoundError:
                return None
            except OSError:
                continue  # not a link
            links += 1
            if links > _MOST_LINKS:
                return None
            whole = PurePosixPath(os.path.normpath(done.parent / target))
            parts = [*whole.parts[1:], *parts]
            done = PurePosixPath("/")
        return done

    def _serial_ports(self) -> tuple[DeviceFact, ...]:
        found = []
        for pattern in _PORTS:
            for place in sorted(self._root.glob(pattern)):
                if pattern == "ttyS*" and not _fitted(place.name):
                    continue  # the kernel creates nodes for ports that the board does not have
                fact = self._inspect(f"/dev/{place.name}")
                if fact is not None and fact.character:
                    found.append(fact)
        return tuple(found)

    def _describe(self, name: str) -> str:
        """The description of a serial port, as pyserial formats it; empty for other devices."""
        if not name.startswith(("tty", "rfcomm")):
            return ""
        with self._lock:
            now = self._clock.mono()
            known = self._described.get(name)
            if known is not None and now - known[0] < DESCRIPTION_S:
                return known[1]
            if len(self._described) >= _MOST_DESCRIPTIONS:
                self._described.clear()
            text = _port_words(name)
            self._described[name] = (now, text)
            return text


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


_GONE = "gone"
"""The device disappeared between looking and opening."""


def _opened(place: Path) -> tuple[bool | None, str]:
    """Open and close it: whether it can be used, and the reason if not or if unknown."""
    try:
        os.close(os.open(place, _OPENING))
    except FileNotFoundError:
        return None, _GONE
    except OSError as error:
        return _ERRORS.get(error.errno or 0, (False, error.strerror or str(error)))
    return True, ""


def _port_words(name: str) -> str:
    """Product, manufacturer, serial number and USB ids of a port, as far as known."""
    try:
        # Only the name matters: pyserial looks it up in /sys/class/tty, which is the host's in a container too.
        port = SysFS(f"/dev/{name}")
    except (OSError, TypeError, ValueError):
        return ""
    if port.vid is None or port.pid is None:
        return ""
    words = [port.product, port.manufacturer, f"serial {port.serial_number}" if port.serial_number else None]
    return ", ".join([*(str(word) for word in words if word), f"USB {port.vid:04x}:{port.pid:04x}"])


def _fitted(name: str) -> bool:
    """Whether a ttyS port has hardware, determined like in pyserial: its subsystem is not `platform`."""
    try:
        subsystem = SysFS(f"/dev/{name}").subsystem
    except (OSError, TypeError, ValueError):
        return False
    return subsystem is not None and subsystem != "platform"


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "a directory; Docker makes one where the source of a bind mount is missing"
    if stat.S_ISBLK(mode):
        return "a block device"
    return "an ordinary file" if stat.S_ISREG(mode) else "neither device nor file"
