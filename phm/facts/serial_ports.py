"""Data that arrive on serial ports. Part of `phm.facts`; import them from there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class SerialFact:
    """A serial port that PHM reads."""

    open_s: float = 0.0
    """How long it has been read."""
    data_s: float | None = None
    """Since data arrived; None: none did since it was opened."""
    line_s: float | None = None
    """Since a line arrived that matches; None: none did."""
    problem: str = ""
    """Why it is not read, e.g. another program uses it; empty: it is read."""


class SerialProbe(Protocol):
    """Reads serial ports."""

    def inspect(self, path: str, *, baud: int, line: str) -> SerialFact:
        """Return what arrived on the host's `path`. The first call opens it; it is read until PHM ends.

        line: a pattern with `*` and `?`; empty: lines are not compared. Raises CannotTell if too many ports are read.
        """
