"""Resolves host names in a thread, because the C library's resolver has no deadline.

A Docker name may appear minutes after PHM; a dead name server may block a look-up for half a minute.
"""

from __future__ import annotations

import socket
import threading
from typing import Any

from phm.core import threads

Address = tuple[int, Any]
"""Address family and the argument of `socket.connect`."""


class Resolver:
    """Resolves one host and port. Invariant: at most one look-up is in progress."""

    def __init__(self, host: str, port: int, kind: socket.SocketKind, *, passive: bool = False) -> None:
        self._host, self._port, self._kind, self._passive = host.strip("[]"), port, kind, passive
        self._done = threading.Event()
        self._running = False
        self._found: tuple[Address, ...] = ()
        self._problem = ""
        self._lock = threading.Lock()

    @property
    def literal(self) -> bool:
        """The host is an IP address and never changes."""
        try:
            socket.getaddrinfo(self._host, None, flags=socket.AI_NUMERICHOST)
        except OSError:
            return False
        return True

    def ask(self) -> threading.Event:
        """Begin a look-up unless one is in progress. The event is set when `answer` has a result."""
        with self._lock:
            if not self._running:
                self._done = threading.Event()
                thread = threading.Thread(target=self._look_up, name=f"phm-resolve-{self._host}", daemon=True)
                self._running = threads.start_now(thread)
                if not self._running:
                    self._problem = f"the name {self._host} cannot be looked up: no thread can be started"
                    self._done.set()
            return self._done

    def answer(self) -> Address:
        """The first of `answers`."""
        return self.answers()[0]

    def answers(self) -> tuple[Address, ...]:
        """The newest addresses, at least one, in the resolver's order. Raises OSError with a sentence if the name was never resolved."""
        with self._lock:
            if not self._found:
                raise OSError(
                    self._problem or f"the name {self._host} has not been found yet: the name server is silent"
                )
            return self._found

    def newest(self) -> tuple[Address, ...]:
        """The result of the last successful look-up; empty if there was none."""
        with self._lock:
            return self._found

    def _look_up(self) -> None:
        flags = socket.AI_PASSIVE if self._passive else 0
        found, problem = tuple[Address, ...](), ""
        try:
            answers = socket.getaddrinfo(self._host, self._port, type=self._kind, flags=flags)
            found = tuple((int(family), address) for family, _, _, _, address in answers)
        except (OSError, UnicodeError) as error:
            problem = f"the name {self._host} is not known: {getattr(error, 'strerror', None) or error}"
        with self._lock:
            # A failing name server does not invalidate an earlier address.
            self._found, self._problem, self._running = found or self._found, problem, False
            self._done.set()
