"""Wait for sockets and serial ports, and wake the thread that waits.

Linux has `poll` and `eventfd`. `select` is used elsewhere: Windows has no `poll`, and that of macOS does not take serial ports.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
from collections.abc import Iterable

READ, WRITE, LOST = 1, 4, 0x38
"""Events as numbers of `poll` on Linux; LOST: POLLERR, POLLHUP or POLLNVAL."""

if sys.platform == "linux":

    def wait(wanted: Iterable[tuple[int, int]], timeout_s: float | None) -> list[tuple[int, int]]:
        """Wait for events of these descriptors, at most `timeout_s` (None: no limit); those that are ready, with what is."""
        poller = select.poll()
        for fd, events in wanted:
            poller.register(fd, events)
        return poller.poll(None if timeout_s is None else timeout_s * 1000)

    class Bell:
        """`ring` ends the `wait` of a thread that waits for `fd`."""

        def __init__(self) -> None:
            self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

        def ring(self) -> None:
            with contextlib.suppress(OSError):
                os.eventfd_write(self.fd, 1)

        def silence(self) -> None:
            """Clear the wake-ups that arrived so far."""
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(self.fd)

        def __del__(self) -> None:
            with contextlib.suppress(OSError, AttributeError):  # `__init__` may have failed before there was one
                os.close(self.fd)

else:

    def wait(wanted: Iterable[tuple[int, int]], timeout_s: float | None) -> list[tuple[int, int]]:
        """Wait for events of these descriptors, at most `timeout_s` (None: no limit); those that are ready, with what is."""
        asked = list(wanted)
        readers = [fd for fd, events in asked if events & READ]
        writers = [fd for fd, events in asked if events & WRITE]
        # Windows reports a refused connection as an exceptional condition alone.
        readable, writable, failed = select.select(readers, writers, [fd for fd, _ in asked], timeout_s)
        found = [
            (fd, READ * (fd in readable) | WRITE * (fd in writable) | (LOST if fd in failed else 0)) for fd, _ in asked
        ]
        return [(fd, events) for fd, events in found if events]

    class Bell:
        """`ring` ends the `wait` of a thread that waits for `fd`."""

        def __init__(self) -> None:
            self._receiver, self._rope = socket.socketpair()
            self._receiver.setblocking(False)
            self._rope.setblocking(False)
            self.fd = self._receiver.fileno()

        def ring(self) -> None:
            with contextlib.suppress(OSError):  # full: it rings already
                self._rope.send(b"x")

        def silence(self) -> None:
            """Clear the wake-ups that arrived so far."""
            with contextlib.suppress(BlockingIOError):
                self._receiver.recv(4096)
