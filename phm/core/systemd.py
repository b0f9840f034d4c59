"""Notifications to systemd: started, reloading, stopping, and a watchdog signal while the daemon works.

The protocol of sd_notify(3): one datagram of ``NAME=value`` lines to the Unix socket that NOTIFY_SOCKET names. Without this
variable nothing is sent.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import MutableMapping

from phm.core.clock import Clock


class SystemdNotifier:
    """Never raises and never blocks: a lost notification must not harm PHM.

    Takes NOTIFY_SOCKET out of `environ`, so that child processes cannot speak for the daemon.
    """

    def __init__(self, clock: Clock, environ: MutableMapping[str, str] = os.environ) -> None:
        self._clock = clock
        path = environ.pop("NOTIFY_SOCKET", "")
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._usable = path.startswith(("/", "@"))

    def ready(self) -> None:
        """The daemon runs with its configuration: after the start, and after a reload."""
        self._send("READY=1")

    def reloading(self) -> None:
        self._send(f"RELOADING=1\nMONOTONIC_USEC={int(self._clock.mono() * 1e6)}")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def watchdog(self) -> None:
        """The daemon works. systemd restarts a service that does not send this for WatchdogSec."""
        self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if not self._usable:
            return
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as out:
            out.sendto(text.encode("ascii"), self._address)
