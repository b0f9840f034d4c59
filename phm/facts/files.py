"""Files and devices that containers need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol


@dataclass(frozen=True, slots=True)
class FileFact:
    """One path, as `lstat` reports it after links were followed. `sha256` is empty unless it was requested."""

    path: str
    kind: str
    """file, directory or other."""
    size: int
    mode: int
    executable: bool
    sha256: str = ""
    seen_through: str = ""
    """volume or engine: how the file was accessed."""


@dataclass(frozen=True, slots=True)
class TreeFact:
    """A folder compared with its manifest. changed, missing, new: relative paths, sorted, at most MAX_NAMED of each.

    files: files and links in the folder. size: their bytes. pending: how many have not been read since they last changed.
    differing: changed, missing and new files together. unreadable: paths for which PHM lacks the permission or that are faulty.
    """

    files: int
    size: int
    differing: int = 0
    changed: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    new: tuple[str, ...] = ()
    pending: int = 0
    unreadable: tuple[str, ...] = ()

    MAX_NAMED: ClassVar[int] = 20


class FileProbe(Protocol):
    """Reads configured files inside of containers, and compares folders with their manifests."""

    def inspect(self, container: str, path: str, *, digest: bool) -> FileFact | None:
        """Return the file at `path` inside the container, or None if it does not exist.

        Reads a volume mounted into PHM if one contains the path, else asks the engine. With `digest`
        the SHA-256 is calculated, too (cached until size, mtime or inode change).
        """

    def tree(self, container: str, path: str, *, manifest: str, ignore: Sequence[str]) -> TreeFact | None:
        """Compare the folder at `path` inside the container with the file `manifest`; None if the folder does not exist.

        ignore: patterns of names or relative paths that are left out. Raises CannotTell if the manifest or the folder cannot
        be read; the folder must be in a volume that PHM sees.
        """


@dataclass(frozen=True, slots=True)
class DeviceFact:
    """One device file of the host. `openable` is None if opening it was not tried or proves nothing."""

    path: str
    character: bool
    major: int
    minor: int
    openable: bool | None
    reason: str = ""
    description: str = ""
    """For serial ports, the description from pyserial: product, manufacturer, serial number, USB ids."""
    inode: int = 0
    """Inode of the device file, which changes when the device was removed and is back; 0 when unknown."""
    block: bool = False
    """A block device, such as a USB stick."""

    MAX_MATCHES: ClassVar[int] = 100


class DeviceProbe(Protocol):
    """Reads the host's device files."""

    def inspect(self, path: str, *, open_it: bool) -> DeviceFact | None:
        """Return the host's device at `path`, or None if it does not exist.

        If `open_it` is false, only the permission bits are checked: opening an idle serial port raises
        DTR, which resets some autopilots and radios.
        """

    def matching(self, patterns: Sequence[str], *, without: Sequence[str] = ()) -> tuple[DeviceFact, ...]:
        """Return the character and block devices that exist, by patterns of their paths with `*` and `?` in the last part.

        Sorted, each once, links followed, at most DeviceFact.MAX_MATCHES. without: patterns of devices that are left out
        and do not count, links followed as well.
        """

    def serial_ports(self) -> tuple[DeviceFact, ...]:
        """Return the serial ports that exist now, to be named when an expected one is missing."""
