"""What the system knows of a serial port beyond its bytes: its place, errors on the line, and a DTR that stays up. Never raises."""

from __future__ import annotations

import contextlib
import os
import struct
import sys
from dataclasses import dataclass
from typing import Any

TIOCGICOUNT = 0x545D
"""As in asm-generic/ioctls.h, which x86 and ARM use."""
_COUNTERS = struct.Struct("20i")
"""struct serial_icounter_struct: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk, buf_overrun, and nine spare."""
_FRAME, _OVERRUN, _PARITY, _BUFFER_OVERRUN = 6, 7, 8, 10
_CFLAG = 2


@dataclass(frozen=True, slots=True)
class SerialErrorCount:
    """Errors since the driver was loaded. overrun: bytes lost in the chip or in the kernel."""

    framing: int
    overrun: int
    parity: int


def place(path: str, dev_root: str) -> str:
    """Where PHM opens a port: below `dev_root`, the host's /dev, if only that has it. A container has its own /dev, and without
    `devices` the ports are not in it; `device_cgroup_rules` permit opening them here."""
    below = os.path.join(dev_root, os.path.relpath(path, "/dev"))
    inside = path.startswith("/dev/") and not os.path.exists(path) and os.path.exists(below)
    return below if inside else path


if sys.platform == "win32":

    def read_counts(fd: int) -> SerialErrorCount | None:
        """None: PHM opens no serial ports on Windows."""
        return None

    def keep_dtr(fd: int) -> None:
        """Do nothing."""

    def drop_output(port: Any) -> None:
        """Do nothing."""

else:
    import fcntl
    import termios

    def read_counts(fd: int) -> SerialErrorCount | None:
        """None where the driver does not count: pseudo terminals, and some USB adapters. Only Linux counts."""
        if sys.platform != "linux":
            return None
        try:
            raw = fcntl.ioctl(fd, TIOCGICOUNT, bytes(_COUNTERS.size))
        except OSError:
            return None
        found = _COUNTERS.unpack(raw)
        return SerialErrorCount(found[_FRAME], found[_OVERRUN] + found[_BUFFER_OVERRUN], found[_PARITY])

    def keep_dtr(fd: int) -> None:
        """Closing this port does not drop DTR, so opening it again does not raise it: some autopilots and radios take that edge
        for a reset. The driver remembers it, so it also holds for a PHM that is started again."""
        with contextlib.suppress(termios.error, OSError):
            attributes = termios.tcgetattr(fd)
            attributes[_CFLAG] &= ~termios.HUPCL
            termios.tcsetattr(fd, termios.TCSANOW, attributes)

    def drop_output(port: Any) -> None:
        """Discard what was not sent. The port may be gone."""
        with contextlib.suppress(termios.error, OSError):
            port.reset_output_buffer()
