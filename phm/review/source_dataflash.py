"""DataFlash logs of ArduPilot (`.bin`, also compressed): modes, arming, errors, failsafes and texts, with the time of its GPS."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.review import autopilot_names as names
from phm.review.dataflash import FMT, HEAD, records
from phm.review.decompression import gunzipped
from phm.review.events import Event
from phm.review.external_entry import MOST, UNPLACED_S, blocks, text_event
from phm.review.lines import FileSegment, Problems

WANTED = frozenset(("MODE", "ARM", "EV", "ERR", "MSG", "PARM", "GPS"))
GPS_EPOCH_S = 315_964_800 - 18
"""1980-01-06 in UTC, less the leap seconds since then; there was none after 2016."""
WEEK_S = 604_800
FIX_3D = 3
MOST_FIXES = 200
ARMED, DISARMED = 10, 11
"""Ids of the message EV, for firmware without the message ARM."""


def fits(path: Path, head: bytes) -> bool:
    return gunzipped(head).startswith(HEAD + bytes([FMT]))


def read(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    """The whole file is read before the first event: the GPS may have a fix, and so the time, only after minutes."""
    log = _Log()
    for name, row in records(blocks(segment.path, problems), WANTED, problems, segment.path):
        log.take(name, row)
    if log.left_out:
        problems.add(f"more than {MOST} events; the others are left out", segment.path, count=log.left_out)
    yield from log.timed()


class _Log:
    """Events with seconds since boot, until the time and the vehicle are known."""

    def __init__(self) -> None:
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.offsets: list[float] = []
        self.system, self.vehicle, self.left_out = 1, "", 0
        self._has_arm = False
        self._mode: int | None = None

    def take(self, name: str, row: dict[str, Any]) -> None:
        boot_s = _number(row, "TimeUS") / 1e6
        if name == "GPS":
            if _number(row, "GWk") > 0 and _number(row, "Status") >= FIX_3D and len(self.offsets) < MOST_FIXES:
                utc_s = GPS_EPOCH_S + _number(row, "GWk") * WEEK_S + _number(row, "GMS") / 1000
                self.offsets.append(utc_s - boot_s)
        elif name == "PARM":
            if row.get("Name") in ("MAV_SYSID", "SYSID_THISMAV") and 0 < _number(row, "Value") < 256:
                self.system = int(_number(row, "Value"))
        elif not self._repeats(name, row):
            if len(self.events) < MOST:
                self.events.append((boot_s, name, row))
            else:
                self.left_out += 1

    def _repeats(self, name: str, row: dict[str, Any]) -> bool:
        """Whether it says nothing new: the mode is logged again at arming, events are many."""
        if name == "MODE":
            same, self._mode = self._mode == row.get("ModeNum"), row.get("ModeNum")
            return same
        if name == "EV":
            return row.get("Id") not in (ARMED, DISARMED)
        if name == "ARM":
            self._has_arm = True
        elif name == "MSG" and not self.vehicle:
            self.vehicle = names.VEHICLES.get(str(row.get("Message")).partition(" ")[0], "")
        return False

    def timed(self) -> Iterator[Event]:
        offset = statistics.median(self.offsets) if self.offsets else UNPLACED_S
        for boot_s, name, row in self.events:
            made = self._event(name, row, offset + boot_s)
            if made is not None:
                made.placed = bool(self.offsets)
                yield made

    def _event(self, name: str, row: dict[str, Any], utc_s: float) -> Event | None:
        if name == "MSG":
            return text_event(self.system, utc_s, str(row.get("Message", "")))
        if name == "MODE":
            mode = names.ardupilot_mode(self.vehicle, int(_number(row, "ModeNum")))
            reason = names.REASONS.get(int(_number(row, "Rsn")), "")
            text, level = (f"{mode}, by {reason}", "WARN") if reason else (mode, "")
            return Event("mode", system=self.system, utc_s=utc_s, text=text, level=level)
        if name == "ERR":
            subsystem, code = names.subsystem(int(_number(row, "Subsys"))), int(_number(row, "ECode"))
            what = "failsafe" if names.is_failsafe(subsystem) else "error"
            text, level = (f"{subsystem} code {code}", "ERROR") if code else (f"{subsystem} resolved", "")
            return Event(what, system=self.system, utc_s=utc_s, text=text, level=level)
        if name == "EV" and self._has_arm:
            return None
        began = bool(_number(row, "ArmState")) if name == "ARM" else row.get("Id") == ARMED
        text = "armed" if began else "disarmed"
        return Event("arming", system=self.system, utc_s=utc_s, text=text, began=began)


def _number(row: dict[str, Any], column: str) -> float:
    """The number of a field; 0 if it is missing or not a number."""
    value = row.get(column, 0)
    return float(value) if isinstance(value, (int, float)) and abs(value) < 1e18 else 0.0
