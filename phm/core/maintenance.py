"""Maintenance windows as text: ``sun 02:00-04:00``, ``mon-fri 12:00-12:30``, ``2026-11-22 22:00-01:00``, all UTC. Pure."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import date, datetime, timedelta, timezone

LABEL = "phm.maintenance"
"""The container label that holds one window."""
FORM = "write [DAYS or DATE] HH:MM-HH:MM in UTC, e.g. 02:00-04:00, sun 02:00-04:00, mon-fri 12:00-12:30, 2026-11-22 22:00-01:00"
LONGEST_S = 24 * 3600.0
CLOCK_SET_FROM = datetime(2024, 1, 1, tzinfo=timezone.utc).timestamp()
"""A clock that shows an earlier time was never set: no window is open then."""

_DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_TEXT = re.compile(r"(?:(?P<when>\S+) )?(?P<begin>[0-9]{2}:[0-9]{2})-(?P<end>[0-9]{2}:[0-9]{2})")


@dataclass(frozen=True, slots=True)
class Window:
    """days: 0 is Monday; empty: every day. on: a single day, else None. The day is that of the beginning."""

    begin_s: float
    length_s: float
    days: frozenset[int] = frozenset()
    on: date | None = None

    def open_at(self, utc: float) -> tuple[str, float] | None:
        """The occurrence that is open at `utc` (seconds since the epoch): its beginning and end as text, and the remaining
        seconds."""
        if not CLOCK_SET_FROM <= utc < 1e11:
            return None
        midnight = datetime.fromtimestamp(utc, timezone.utc).replace(hour=0, minute=0, second=0, microsecond=0)
        for day in (midnight, midnight - timedelta(days=1)):
            begin = day + timedelta(seconds=self.begin_s)
            end = begin + timedelta(seconds=self.length_s)
            left_s = end.timestamp() - utc
            if self._takes(day.date()) and begin.timestamp() <= utc and left_s > 0:
                return f"{begin:%Y-%m-%dT%H:%MZ}/{end:%H:%MZ}", left_s
        return None

    def has(self, occurrence: str) -> bool:
        """Whether it has this occurrence, with the same beginning and end; text as of `open_at`."""
        try:
            begin = datetime.strptime(occurrence.partition("/")[0], "%Y-%m-%dT%H:%MZ").replace(tzinfo=timezone.utc)
        except ValueError:
            return False
        found = self.open_at(begin.timestamp())
        return found is not None and found[0] == occurrence

    def _takes(self, day: date) -> bool:
        if self.on is not None:
            return day == self.on
        return not self.days or day.weekday() in self.days


def parse(text: str) -> Window:
    """The window that `text` describes. Raises ValueError with what is wrong and what is allowed."""
    match = _TEXT.fullmatch(" ".join(text.lower().split()))
    if match is None:
        raise ValueError(f"{text[:60]!r} is not a maintenance window: {FORM}")
    begin_s, end_s = _seconds(match["begin"]), _seconds(match["end"])
    if begin_s is None or end_s is None or begin_s == end_s:
        raise ValueError(f"{text[:60]!r} has a time that does not exist, or no length: {FORM}")
    days, on = _days(match["when"] or "")
    if days is None:
        raise ValueError(f"{match['when'][:30]!r} is neither days nor a date: {FORM}")
    return Window(begin_s, (end_s - begin_s) % LONGEST_S, days, on)


def _seconds(text: str) -> float | None:
    hours, minutes = (int(part) for part in text.split(":"))
    return hours * 3600.0 + minutes * 60.0 if hours < 24 and minutes < 60 else None


def _days(text: str) -> tuple[frozenset[int] | None, date | None]:
    if not text:
        return frozenset(), None
    try:
        return frozenset(), date.fromisoformat(text)
    except ValueError:
        pass
    found: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if first not in _DAYS or (dash and last not in _DAYS):
            return None, None
        start, length = _DAYS.index(first), (_DAYS.index(last) - _DAYS.index(first)) % 7 if dash else 0
        found.update((start + offset) % 7 for offset in range(length + 1))
    return frozenset(found), None
