"""Chooses the lines of a log that are shown."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from phm.logs.reader import LogReader
from phm.wire import json_log

Json = Mapping[str, Any]

REGULAR = frozenset(("unit", "report_started", "report"))
"""Events of the report that PHM makes at each interval."""
_FLIGHT = b'"flight"'


@dataclass(frozen=True)
class LineFilter:
    """An empty part allows everything.

    units:   patterns as in a shell; `*` matches `/`, too.
    kinds:   words of the text log, in capitals.
    levels:  `OK`, `WARN`, `ERROR`, `STALE`, `n/a`; lines without a level are left out then.
    agents:  names (patterns), or ids.
    since_s: UTC seconds.
    reports: also the lines of the regular reports.
    """

    units: tuple[str, ...] = ()
    kinds: frozenset[str] = frozenset()
    levels: frozenset[str] = frozenset()
    agents: tuple[str, ...] = ()
    since_s: float | None = None
    reports: bool = False

    def takes(self, event: Json) -> bool:
        if event.get("event") in REGULAR and not self.reports and "REPORT" not in self.kinds:
            return False
        if self.kinds and event.get("kind") not in self.kinds:
            return False
        if self.levels and level(event) not in self.levels:
            return False
        if self.units and not _matches(str(event.get("unit", "")), self.units):
            return False
        return self.covers(event)

    def covers(self, event: Json) -> bool:
        """Whether its time and agent are wanted: gaps of the log there are shown, whatever is missing."""
        if self.since_s is not None and utc_s(event) < self.since_s:
            return False
        return not self.agents or self._is_of_agent(event)

    def _is_of_agent(self, event: Json) -> bool:
        number = event.get("agent_id")
        named = _matches(str(event.get("agent", "")), self.agents)
        return named or (isinstance(number, int) and any(_id(agent) == number for agent in self.agents))


class TakeOff:
    """Lets events through from the beginning of a flight on. mark: boot_id and number of its line; None: the next one that begins."""

    def __init__(self, mark: tuple[object, int] | None = None) -> None:
        self._mark, self._begun = mark, False

    def takes(self, event: Json) -> bool:
        if not self._begun:
            self._begun = self._is_beginning(event)
        return self._begun

    def _is_beginning(self, event: Json) -> bool:
        if self._mark is None:
            return _begins(event)
        boot, seq = self._mark
        return event.get("boot_id") == boot and number(event.get("seq")) >= seq


NOTHING = TakeOff((object(), 0))
"""A gate that takes no event."""


def take_off(reader: LogReader) -> TakeOff | None:
    """The gate for the last flight in the log; None: there is no flight in it. Reads the log.

    After a restart in flight the log has a second beginning of the same flight: the first counts. The number alone does not
    show that: numbers begin again when `state_dir` was lost.
    """
    found: tuple[object, object, int] | None = None
    for line in reader.lines(last=True):
        event = json_log.parse(line) if _FLIGHT in line else None
        if event is None or not _begins(event):
            continue
        goes_on = event.get("continued") is True and found is not None and event.get("number") == found[0]
        if not goes_on:
            found = (event.get("number"), event.get("boot_id"), int(number(event.get("seq"))))
    return None if found is None else TakeOff(found[1:])


def _begins(event: Json) -> bool:
    return event.get("event") == "flight" and event.get("began") is True


def level(event: Json) -> str:
    """The level that the line gives a unit; empty: none."""
    return "ERROR" if event.get("event") == "fault_opened" else str(event.get("level", ""))


def utc_s(event: Json) -> float:
    """UTC seconds of a line; 0 for a line without a time."""
    return number(event.get("utc_s"))


def number(value: object) -> float:
    """As a float; 0 for what is none, or is too large for one. Python reads integers of any length."""
    return float(value) if isinstance(value, (int, float)) and abs(value) < 1e15 else 0.0


def _matches(text: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch.fnmatchcase(text, pattern) for pattern in patterns)


def _id(text: str) -> int | None:
    """The id of an agent given as ``A05`` or ``5``; None for other text."""
    digits = text[1:] if text[:1] in "Aa" else text
    return int(digits) if digits.isdecimal() and len(digits) < 6 else None
