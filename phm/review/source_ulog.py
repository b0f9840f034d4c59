"""Logs of PX4 (ULog): modes, arming, failsafes and texts, with the time of its GPS."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from phm.review import autopilot_names as names
from phm.review.decompression import gunzipped
from phm.review.events import Event
from phm.review.external_entry import EARLIEST_S, MOST, UNPLACED_S, blocks, text_event
from phm.review.lines import FileSegment, Problems
from phm.review.ulog import MAGIC, messages

STATUS, FIXES = "vehicle_status", ("vehicle_gps_position", "sensor_gps")
WANTED = frozenset((STATUS, *FIXES))
LABELS = frozenset(("timestamp", "arming_state", "nav_state", "failsafe", "time_utc_usec"))
ARMED = 2
"""The value of ARMING_STATE_ARMED."""
MOST_FIXES = 200


def fits(path: Path, head: bytes) -> bool:
    return gunzipped(head).startswith(MAGIC)


def read(segment: FileSegment, problems: Problems) -> Iterator[Event]:
    """The whole file is read before the first event, because its time and system may come later."""
    log = _Log()
    for name, row in messages(blocks(segment.path, problems), WANTED, LABELS, problems, segment.path):
        log.take(name, row)
    if log.left_out:
        problems.add(f"more than {MOST} events; the others are left out", segment.path, count=log.left_out)
    offset = statistics.median(log.offsets) if log.offsets else UNPLACED_S
    for event in log.events:
        event.system, event.utc_s, event.placed = log.system, event.utc_s + offset, bool(log.offsets)
        yield event


class _Log:
    """Events with seconds since boot, until the time is known."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.offsets: list[float] = []
        self.system, self.left_out = 1, 0
        self._before: dict[str, Any] = {"arming_state": 0, "failsafe": False}

    def take(self, name: str, row: dict[str, Any]) -> None:
        boot_s = float(row.get("timestamp", 0)) / 1e6
        if name in FIXES:
            utc_s = float(row.get("time_utc_usec", 0)) / 1e6
            if utc_s > EARLIEST_S and len(self.offsets) < MOST_FIXES:
                self.offsets.append(utc_s - boot_s)
        elif name == "parameter":
            if row["name"] == "MAV_SYS_ID" and 0 < row["value"] < 256:
                self.system = int(row["value"])
        elif name == "text":
            level = "ERROR" if row["level"] <= 3 else "WARN" if row["level"] == 4 else ""
            self._add(text_event(0, boot_s, row["text"], level=level))
        else:
            self._status(boot_s, row)

    def _status(self, boot_s: float, row: dict[str, Any]) -> None:
        before, self._before = self._before, {**self._before, **row}
        if "nav_state" in row and row["nav_state"] != before.get("nav_state"):
            self._add(Event("mode", utc_s=boot_s, text=names.px4_nav_state(row["nav_state"])))
        armed = self._before["arming_state"] == ARMED
        if armed is not (before["arming_state"] == ARMED):
            self._add(Event("arming", utc_s=boot_s, text="armed" if armed else "disarmed", began=armed))
        failsafe = bool(self._before["failsafe"])
        if failsafe is not bool(before["failsafe"]):
            text, level = ("failsafe active", "ERROR") if failsafe else ("failsafe ended", "")
            self._add(Event("failsafe", utc_s=boot_s, text=text, level=level, began=failsafe))

    def _add(self, event: Event) -> None:
        if len(self.events) < MOST:
            self.events.append(event)
        else:
            self.left_out += 1
