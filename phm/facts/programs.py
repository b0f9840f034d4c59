"""Programs that the user has PHM run, and processes that PHM sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from phm.facts.docker import ProcessFact


@dataclass(frozen=True, slots=True)
class ProgramFact:
    """One run. output: the beginning of what it wrote to standard output, or if that is nothing, to standard error."""

    exit_code: int
    output: str
    took_s: float


class ProgramProbe(Protocol):
    """Runs programs, and lists processes."""

    def run(self, argv: Sequence[str], *, timeout_s: float, container: str = "") -> ProgramFact:
        """Run a program and wait for its end, in a container or beside PHM; no shell is used.

        Raises CannotTell if it cannot be started, or does not end in time. Beside PHM it is killed then, with its children.
        """

    def processes(self) -> tuple[ProcessFact, ...]:
        """The processes that PHM sees, without PHM itself."""
