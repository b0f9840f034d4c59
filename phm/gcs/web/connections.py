"""Limits the connections of the server: their number, how long one may ask nothing, and how long one may not read.

aiohttp itself has no such limits. Everything here runs in the event loop.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from phm.core.clock import Clock

MAX_CONNECTIONS = 256
GREET_S = 10.0
"""A complete request must be here within this time after the connection was seen."""
STUCK_S = 10.0
"""A response that waits to be read is given up after this time without progress."""
_NEVER = float("inf")


class Connections:
    """`served` notes a request; `prune` ends those that exceed a limit."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._limits: dict[Any, float] = {}
        """The moment at which each connection is closed unless it makes progress, by its transport."""
        self._waiting: dict[Any, int] = {}
        """Bytes of a response that the client has not read yet, at the last `prune`."""
        self.refused = 0

    def __len__(self) -> int:
        return len(self._limits)

    def served(self, transport: Any) -> None:
        """Note that a complete request arrived on this connection."""
        self._limits[transport] = _NEVER

    def prune(self, transports: Iterable[Any]) -> None:
        """Close connections that exceed a limit; call it often. transports: those of all open connections."""
        now, found = self._clock.mono(), [one for one in transports if one is not None and not one.is_closing()]
        for gone in self._limits.keys() - set(found):
            self._forget(gone)
        for transport in found:
            if transport not in self._limits and len(self._limits) >= MAX_CONNECTIONS:
                self.refused += 1
                transport.abort()
                continue
            self._limits.setdefault(transport, now + GREET_S)
            self._progress(transport, now)
            if now >= self._limits[transport]:
                self._forget(transport)
                transport.abort()

    def _progress(self, transport: Any, now: float) -> None:
        """Move the limit of a connection with a response that is being read."""
        waiting, before = transport.get_write_buffer_size(), self._waiting.get(transport)
        if waiting and (before is None or waiting != before):
            self._waiting[transport], self._limits[transport] = waiting, now + STUCK_S
        elif not waiting and before is not None:
            del self._waiting[transport]
            self._limits[transport] = _NEVER

    def _forget(self, transport: Any) -> None:
        self._limits.pop(transport, None)
        self._waiting.pop(transport, None)
