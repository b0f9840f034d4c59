"""What all fakes can."""

from __future__ import annotations

from phm.facts import CannotTell


class Fake:
    """What all fakes can: fail on request, and count how often they were asked."""

    def __init__(self) -> None:
        self._problem: Exception | None = None
        self.calls = 0

    def fail(self, problem: str | Exception = "the fake fails on request") -> None:
        """From now on raise `problem`; a text becomes a `CannotTell`."""
        self._problem = CannotTell(problem) if isinstance(problem, str) else problem

    def work(self) -> None:
        """Answer again."""
        self._problem = None

    def _asked(self) -> None:
        self.calls += 1
        if self._problem is not None:
            raise self._problem
