"""All runs of one agent, on the time axis of the record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from phm.review.agent_run import Change, Run, RunMark
from phm.review.clocks import RunClock
from phm.review.spans import Span


@dataclass
class AgentRecord:
    """One agent; the id 0: a recording of which the agent is not known. cover: when its PHM wrote;
    armed: when its autopilot was, as far as known; flying: it was at the end."""

    name: str
    id: int
    runs: list[tuple[Run, RunClock]] = field(default_factory=list)
    cover: list[Span] = field(default_factory=list)
    armed: list[Span] = field(default_factory=list)
    flying: bool = False
    changes: list[tuple[float, Change]] = field(default_factory=list)
    marks: list[tuple[float, RunMark]] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    reports: list[float] = field(default_factory=list)

    @property
    def end(self) -> float:
        return self.cover[-1][1] if self.cover else 0.0

    @property
    def vehicle(self) -> bool:
        """Whether the agent is a vehicle; False: it is only a recording."""
        return bool(self.id or self.runs)
