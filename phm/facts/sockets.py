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


@dataclass(frozen=True, slots=True)
class HttpFact:
    """One GET request. problem: why there is no answer, as a clause; empty: there is one.

    location: where a redirect leads. body: its beginning. found: whether the pattern is in it.
    """

    problem: str
    took_s: float
    status: int = 0
    location: str = ""
    body: str = ""
    found: bool = True


class SocketProbe(Protocol):
    """Connects to servers. Each call ends at its deadline.

    Raises CannotTell if PHM itself is the cause, e.g. a name server that does not answer.
    """

    def connect(self, host: str, port: int, *, timeout_s: float, expect: str = "") -> ConnectionFact:
        """Connect over TCP, and read until `expect` is received, if it is not empty, or the server ends or the time is over."""

    def get(self, url: str, *, timeout_s: float, pattern: str = "", verify_tls: bool = True) -> HttpFact:
        """Request `url`, follow no redirect, and search the regular expression in the beginning of the body."""
