"""The process of one node, as the readings of the process list show it over time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from phm import api
from phm_checks._process_matching import Match

WINDOW_S, BUSY_SHARE = 3.0, 0.5
"""A process that used this share of one CPU over at least this time is busy. `ps` reports whole seconds."""
_KEPT = 12


@dataclass(slots=True)
class KnownProcess:
    """The process of one node. used: the times of its readings, each with the CPU time used until then."""

    match: Match
    first: bool = True
    """It started with the container, or before PHM: no other process of the node was seen in this generation."""
    began_at: float = float("inf")
    """When it was started, or a little later: the earliest start time that the readings have shown."""
    used: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_KEPT))
    state: str = ""
    command: str = ""
    idle_since: float = float("inf")
    """The first reading of its present CPU time, in whole seconds: it has used less than one since."""
    ended_at: float = float("inf")
    """When the process was first found missing."""

    @property
    def pid(self) -> int:
        return self.match.process.pid

    @property
    def there(self) -> bool:
        return self.ended_at == float("inf")

    def observe(self, now: float, process: api.ProcessFact | None) -> None:
        if process is None:
            self.ended_at = min(self.ended_at, now)
            return
        self.state, self.command = process.state, process.command
        self.began_at = min(self.began_at, now - (process.age_s or 0.0))
        if process.cpu_s is None:
            self.used.clear()  # earlier CPU use says nothing about the present
        else:
            if not self.used or self.used[-1][1] != process.cpu_s:
                self.idle_since = now
            self.used.append((now, process.cpu_s))
            while len(self.used) > 2 and now - self.used[1][0] >= WINDOW_S:
                self.used.popleft()

    @property
    def measured(self) -> bool:
        """Whether its CPU use is known: its CPU time was measured over WINDOW_S, or it is running on a CPU now."""
        return self.state == "R" or (len(self.used) > 1 and self.used[-1][0] - self.used[0][0] >= WINDOW_S)

    @property
    def busy(self) -> bool:
        """Whether its main thread is running on a CPU, or all its threads together have used much of one CPU."""
        if self.state == "R":
            return True
        if not self.used:
            return False
        (first, before), (last, after) = self.used[0], self.used[-1]
        return last - first >= WINDOW_S and after - before >= BUSY_SHARE * (last - first)
