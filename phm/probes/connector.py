"""Opens connections to servers, with one deadline for the name, the connection and all that follows."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from phm.core.clock import Clock
from phm.facts import CannotTell
from phm.probes.blocking_call import BlockingCallWorker
from phm.transport.call_deadlines import CallDeadlines, PendingCall

MOST_ADDRESSES = 4
"""Of a name with several addresses, this many are tried."""
_OURS = {errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS, errno.EACCES, errno.EPERM}
"""Errors that say nothing about the server."""


class NotConnected(Exception):
    """The server cannot be connected; the text is a clause that says why."""


@dataclass(frozen=True)
class TimedCall:
    """One call with its deadline."""

    pending: PendingCall
    clock: Clock

    @property
    def left_s(self) -> float:
        return max(0.01, self.pending.began + self.pending.limit_s - self.clock.mono())

    @property
    def took_s(self) -> float:
        return self.clock.mono() - self.pending.began


class Connector:
    """Opens connections. Thread-safe: each host name has a thread for its look-ups, which can hang."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._deadlines = CallDeadlines(clock, "phm-socket-deadlines")
        self._resolvers: dict[str, BlockingCallWorker] = {}
        self._lock = threading.Lock()

    def close(self) -> None:
        """End running calls; every later call fails immediately."""
        self._deadlines.close()
        with self._lock:
            for resolver in self._resolvers.values():
                resolver.close()

    @contextlib.contextmanager
    def calling(self, timeout_s: float) -> Iterator[TimedCall]:
        """One call, which ends after `timeout_s` at the latest. Raises CannotTell while PHM stops."""
        with self._deadlines.watch(timeout_s) as pending:
            if pending.expired:
                raise CannotTell("PHM is stopping")
            yield TimedCall(pending, self._clock)

    def open(self, host: str, port: int, call: TimedCall) -> socket.socket:
        """A connected socket that the deadline interrupts. Raises NotConnected, or CannotTell if PHM is the cause."""
        problem = ""
        for family, address in self._addresses(host, port, call):
            connection = None
            try:
                connection = socket.socket(family, socket.SOCK_STREAM)
                connection.settimeout(call.left_s)
                call.pending.attach(connection)
                connection.connect(address)
            except OSError as error:
                if connection is not None:
                    connection.close()
                demand_not_ours(error, host)
                timed_out = isinstance(error, TimeoutError) or call.pending.expired
                problem = f"no answer within {call.pending.limit_s:g} s" if timed_out else _reason(error)
                if timed_out:
                    break
            else:
                return connection
        raise NotConnected(problem)

    def _addresses(self, host: str, port: int, call: TimedCall) -> list[tuple[int, Any]]:
        with self._lock:
            resolver = self._resolvers.setdefault(host, BlockingCallWorker(f"resolve-{host}"))
        try:
            found = resolver.call(lambda: socket.getaddrinfo(host, port, type=socket.SOCK_STREAM), call.left_s)
        except socket.gaierror as error:
            if error.errno == socket.EAI_AGAIN:
                raise CannotTell(f"the name {host} cannot be looked up: the name server does not answer") from error
            raise NotConnected(f"the name {host} is not known") from error
        except (OSError, UnicodeError) as error:
            raise CannotTell(f"the name {host} cannot be looked up: {error}") from error
        return [(entry[0], entry[4]) for entry in found[:MOST_ADDRESSES]]


def demand_not_ours(error: OSError, host: str) -> None:
    """Raises CannotTell if the error says nothing about the server, e.g. that PHM has no free file descriptor."""
    if error.errno in _OURS:
        raise CannotTell(f"PHM cannot connect to {host}: {os.strerror(error.errno or 0)}") from error


def _reason(error: OSError) -> str:
    if isinstance(error, ConnectionRefusedError):
        return "the connection was refused"
    return f"the connection failed: {error.strerror or error}"
