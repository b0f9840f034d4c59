"""An agent's health, read from PHM's own record. Pure but for the reading."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from phm.wire.report import OK_LEVELS
from sitl.harness.log_follower import Event, Record

MOST_NAMED = 4
MACHINE = "host/"
"""Units that judge the machine. All agents of a swarm share this one, and what loads it need not be the swarm."""


class Health:
    """Feed it the events of one `phm.jsonl` in order. but: beginnings of units that do not count."""

    def __init__(self, but: tuple[str, ...] = ()) -> None:
        self._but = but
        self.array: list[Any] | None = None
        """Slots 1 to 8 of the last report; None before the first one."""
        self.open: dict[str, str] = {}
        """Open faults by id, with their units."""
        self.last_utc_s: float | None = None
        self._levels: dict[str, str] = {}

    def feed(self, events: Iterable[Event]) -> None:
        for event in events:
            self._take(event)

    def _take(self, event: Event) -> None:
        kind = event["event"]
        if str(event.get("unit", "")).startswith(self._but or "\n"):
            return
        self.last_utc_s = event.get("utc_s", self.last_utc_s)
        if kind == "start":
            self.array = None
            self._levels.clear()
        elif kind in ("unit", "transition"):
            self._levels[event["unit"]] = event["level"]
        elif kind == "report":
            self.array = event["status_array"]
        elif kind == "fault_opened":
            self.open[event["fault"]] = event["unit"]
        elif kind == "fault_closed":
            self.open.pop(event["fault"], None)

    @property
    def bad(self) -> dict[str, str]:
        """Units that are not OK or n/a, with their level."""
        return {unit: level for unit, level in self._levels.items() if level not in OK_LEVELS}

    @property
    def healthy(self) -> bool:
        """A report was made since PHM's start, every unit is OK since, and no fault is open."""
        return self.array is not None and not self.bad and not self.open

    @property
    def why(self) -> str:
        """What is not OK, in a few words; empty when all is."""
        if self.healthy:
            return ""
        if self.array is None:
            return "no report of PHM yet"
        words = [f"{unit} {level}" for unit, level in self.bad.items()]
        words += [f"open fault at {unit}" for unit in self.open.values() if unit not in self.bad]
        more = f" and {len(words) - MOST_NAMED} more" if len(words) > MOST_NAMED else ""
        return ", ".join(words[:MOST_NAMED]) + more

    def why_not(self, utc_s: float, fresh_s: float) -> str:
        """As `why`, and a record that has not grown for this long is not OK either."""
        if self.last_utc_s is not None and utc_s - self.last_utc_s > fresh_s:
            return f"PHM has written nothing for {utc_s - self.last_utc_s:.0f} s"
        return self.why


class HealthMonitor:
    """The standing of one agent, kept up to date from its record. but: as `Health`."""

    def __init__(self, path: Path, but: tuple[str, ...] = ()) -> None:
        self._record = Record(path)
        self._seen = 0
        self.standing = Health(but)

    def update(self) -> Health:
        self._record.update()
        self.standing.feed(self._record.events[self._seen :])
        self._seen = len(self._record.events)
        return self.standing
