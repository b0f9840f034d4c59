"""What a report leaves out because there is more of it than it takes: each limit says so, and how many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, TypeVar

Row = TypeVar("Row")
Json = dict[str, Any]


class OmittedCounts:
    """Counts of what is left out, by agent and by what it is."""

    def __init__(self) -> None:
        self._found: Counter[tuple[str, str]] = Counter()

    def add(self, agent: str, what: str, count: int) -> None:
        """agent: empty: of all agents together."""
        if count > 0:
            self._found[agent, what] += count

    def keep(self, agent: str, what: str, rows: Sequence[Row], most: int) -> list[Row]:
        """The first `most` of them; the others are counted."""
        self.add(agent, what, len(rows) - most)
        return list(rows[:most])

    def longest(self, agent: str, what: str, spans: Sequence[Sequence[float]], most: int) -> list[Sequence[float]]:
        """The `most` longest of them in the order of time; the others are counted."""
        by_length = sorted(spans, key=lambda span: span[0] - span[1])
        return sorted(self.keep(agent, what, by_length, most), key=lambda span: span[0])

    def rows(self) -> list[Json]:
        return [{"agent": agent, "what": what, "count": count} for (agent, what), count in sorted(self._found.items())]
