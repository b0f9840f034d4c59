"""PHM's own condition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class SelfFact:
    """PHM's own health. Empty tuples mean that there are no problems."""

    uptime_s: float
    overdue: tuple[str, ...] = ()
    """Checks that have not finished within their deadline."""
    dropped: Mapping[str, int] = field(default_factory=dict)
    """Events that a slow reporter has lost, by reporter."""
    problems: tuple[str, ...] = ()
    """Sentences, e.g. `log: no space left on /var/log/phm, 12 lines kept in memory`."""
    ros_restarts: int = 0
    ended_badly: bool = False
    """The previous PHM process was killed, crashed, or ended itself because it had stalled."""
    suspended_s: float | None = None
    """How long the last suspension of the entire PHM process lasted; None: it was never suspended."""
    suspended_ago_s: float | None = None
    was_stopped: bool = False
    """A signal had suspended it, and the watchdog resumed it."""


class SelfProbe(Protocol):
    """Reads the state of PHM itself."""

    def snapshot(self) -> SelfFact:
        """Return the present state."""
