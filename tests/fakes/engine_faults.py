"""Faults that the fake Docker Engine injects into its answers."""

from __future__ import annotations

from dataclasses import dataclass

PATIENCE_S = 60.0
"""After this a hanging or trickling answer ends, so that a test that forgot its deadline fails instead of hanging."""


@dataclass(frozen=True)
class Fault:
    """Base of all faults; `route` limits it to requests whose path contains that text."""

    route: str = ""


@dataclass(frozen=True)
class Hang(Fault):
    """Take the request and never answer."""


@dataclass(frozen=True)
class Trickle(Fault):
    """Send the right bytes, one every `every_s` seconds; `endless` pads so that it takes a minute."""

    every_s: float = 0.05
    endless: bool = True


@dataclass(frozen=True)
class Status(Fault):
    code: int = 500
    message: str = "injected"

    def __init__(self, code: int = 500, message: str = "injected", route: str = "") -> None:
        object.__setattr__(self, "code", code)
        object.__setattr__(self, "message", message)
        object.__setattr__(self, "route", route)


@dataclass(frozen=True)
class Garbage(Fault):
    """HTTP, but no JSON."""


@dataclass(frozen=True)
class NoHttp(Fault):
    """Something other than HTTP."""


@dataclass(frozen=True)
class Truncate(Fault):
    """Close the connection in the middle of the body."""


@dataclass(frozen=True)
class Oversize(Fault):
    """A JSON response of `size` bytes, in pieces."""

    size: int = 64 << 20


@dataclass(frozen=True)
class DropStream(Fault):
    """Event streams end immediately: open ones and new ones, as long as the fault lasts."""
