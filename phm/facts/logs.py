"""New lines of logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class LogFact:
    """What was written since the previous call. lines: how many were read.

    counts: how many of them match, for each pattern. last: the newest line that matches, for each pattern; empty: none.
    skipped: bytes that were not read, because too much was written.
    """

    lines: int
    counts: tuple[int, ...]
    last: tuple[str, ...]
    skipped: int = 0


@dataclass
class LogMemory:
    """What a check of a log keeps over a reload of the configuration.

    found: by pattern, when it was last found (monotonic seconds), how often since it was quiet, and the newest line.
    generation: of the container that recovery acts on, see `ContainerFact.generation`.
    begun: when the log was first read (monotonic seconds), or less if what was found before does not count any more; None: never.
    """

    found: dict[str, tuple[float, int, str]] = field(default_factory=dict)
    generation: str = ""
    begun: float | None = None


class LogProbe(Protocol):
    """Reads new lines of files and of container logs."""

    def follow(
        self, reader: str, *, patterns: Sequence[str], timeout_s: float, path: str = "", container: str = ""
    ) -> LogFact:
        """The lines of a file or of a container's Docker log since the previous call of this reader; its first call reads none.

        reader: a name for the position in the log. Raises CannotTell if the log cannot be read, or the patterns take too long.
        """

    def memory(self, reader: str) -> LogMemory:
        """That of the reader, which the check changes. It is kept with the position in the log, as long as the log is the same."""
