"""What servers answer to PHM's own connections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class ConnectionFact:
    """One attempt to connect. problem: why it failed, as a clause; empty: it is connected. received: what the server sent first."""

    problem: str
    took_s: float
    received: str = ""


class SocketProbe(Protocol):
    """Connects to servers. Each call ends at its deadline."""

    def connect(self, host: str, port: int, *, timeout_s: float, expect: str = "") -> ConnectionFact:
        """Connect over TCP, and read until `expect` is received, if it is not empty, or the server ends or the time is over.

        Raises CannotTell if PHM itself is the cause, e.g. a name server that does not answer.
        """
