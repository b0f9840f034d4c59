"""One run of PHM on one agent, as a report keeps it: what of its lines, in bounded memory."""

from __future__ import annotations

import itertools
from array import array
from dataclasses import dataclass, field
from typing import Any

from phm.review.cost import Cost
from phm.review.received_frames import ReceivedFrames
from phm.review.series import POINTS, Series
from phm.review.spans import Cover

MOST_SERIES = 512
MOST_POINTS = 64 * POINTS
"""Of all series of a run: where there are more than 64, each has fewer points."""
MOST_NAMES = 1000
MOST_CHECKS = 256
COVER_S = 30.0


@dataclass
class Change:
    """A transition of a unit."""

    seq: int
    mono: float
    unit: str
    level: str
    old: str
    summary: str
    brief: str
    condition: str
    blocked_by: str
    fault: str
    text_only: bool
    values: dict[str, Any]
    """The values of the result; only kept for ERROR."""


@dataclass
class RunMark:
    """A line that is not about a unit: note, hold, flight, action, lost. body: its further keys."""

    seq: int
    mono: float
    what: str
    text: str
    body: dict[str, Any]


@dataclass
class Run:
    """One run of PHM on one agent: its lines share a `boot_id` and a monotonic clock."""

    agent: str
    agent_id: int
    boot_id: str
    folders: set[str] = field(default_factory=set)
    """The folders of its files."""
    version: str = ""
    interval_s: float = 0.0
    started: float | None = None
    machine_boot: str = ""
    """Runs of one start of the machine share its monotonic clock; empty: unknown."""
    lines: int = 0
    left_out: int = 0
    cover: Cover = field(default_factory=lambda: Cover(COVER_S))
    numbers: Cover = field(default_factory=lambda: Cover(1.0))
    clock: list[tuple[float, float]] = field(default_factory=list)
    """(mono, utc - mono), at the first line and after each step."""
    changes: list[Change] = field(default_factory=list)
    unlogged: list[Change] = field(default_factory=list)
    """Lines of units in reports with another level than the line before about the unit: that about the change was lost."""
    last_level: dict[str, str] = field(default_factory=dict)
    """The level in the last line about each unit."""
    marks: list[RunMark] = field(default_factory=list)
    faults: dict[str, dict[str, Any]] = field(default_factory=dict)
    units: dict[str, dict[str, Any]] = field(default_factory=dict)
    """check, slot, layer, target, and the first level with its time."""
    causes: list[tuple[float, str, str]] = field(default_factory=list)
    """(mono, unit, blocked_by), when a line about a unit has another `blocked_by` than the one before."""
    last_cause: dict[str, str] = field(default_factory=dict)
    """`blocked_by` of the last line about each unit."""
    reports: array[float] = field(default_factory=lambda: array("d"))
    took_at: array[float] = field(default_factory=lambda: array("d"))
    took_s: array[float] = field(default_factory=lambda: array("d"))
    """How long the report at this time took, in seconds."""
    check_ms: dict[str, list[float]] = field(default_factory=dict)
    """Of each check: number of lines, sum and largest of `duration_ms`."""
    boots: dict[int, list[float]] = field(default_factory=dict)
    """By number of reboots: how often, least and largest of mono minus the autopilot's time since boot."""
    armed: list[tuple[float, bool]] = field(default_factory=list)
    """(mono, whether the autopilot was armed), when a line of its check says something new: for logs without flights."""
    cost: Cost = field(default_factory=Cost)
    received: ReceivedFrames = field(default_factory=ReceivedFrames)
    """When which frames were received, by system, component and frame number: monotonic seconds."""
    series: dict[str, Series] = field(default_factory=dict)
    unplotted: set[str] = field(default_factory=set)
    """Names of measurements beyond MOST_SERIES."""

    def levels(self) -> list[Change]:
        """What lines say of the levels of units, in the order of time, also where the line about a change was lost."""
        return sorted([*self.changes, *self.unlogged], key=lambda change: (change.mono, change.seq))

    def series_of(self, name: str, new: Series | None = None) -> Series | None:
        """The series of this measurement, or `new` if there is room for it; None: there is none."""
        found = self.series.get(name)
        if found is None and len(self.series) < MOST_SERIES:
            found = self.series[name] = new or Series()
            self._share_points()
        elif found is None and len(self.unplotted) < MOST_NAMES:
            self.unplotted.add(name)
        return found

    def _share_points(self) -> None:
        most = POINTS
        while most * len(self.series) > MOST_POINTS:
            most //= 2
        for series in self.series.values():
            series.limit(most)

    def merge(self, other: Run) -> None:
        self.folders |= other.folders
        self.version, self.interval_s = self.version or other.version, self.interval_s or other.interval_s
        self.machine_boot = self.machine_boot or other.machine_boot
        self.started = self.started if other.started is None else other.started
        self.lines, self.left_out = self.lines + other.lines, self.left_out + other.left_out
        self.cover.merge(other.cover)
        self.numbers.merge(other.numbers)
        self.clock = sorted({*self.clock, *other.clock})
        self.changes += other.changes
        self.unlogged += other.unlogged
        self.marks += other.marks
        for fault, known in other.faults.items():
            mine = self.faults.setdefault(fault, known)
            if mine is not known:
                self.faults[fault] = {**known, **mine} if mine["closed_at"] is not None else {**mine, **known}
                opened = [each["opened_at"] for each in (mine, known) if each["opened_at"] is not None]
                self.faults[fault]["opened_at"] = min(opened) if opened else None
        for unit, body in other.units.items():
            mine = self.units.setdefault(unit, body)
            if body["at"] < mine["at"]:
                self.units[unit] = body
        self.causes += other.causes
        self.reports.extend(other.reports)
        self.armed = sorted({*self.armed, *other.armed})
        self.took_at.extend(other.took_at)
        self.took_s.extend(other.took_s)
        for check, (count, whole, most) in other.check_ms.items():
            had = self.check_ms.setdefault(check, [0.0, 0.0, 0.0])
            self.check_ms[check] = [had[0] + count, had[1] + whole, max(had[2], most)]
        for number, seen in other.boots.items():
            had = self.boots.setdefault(number, seen)
            self.boots[number] = [had[0] + seen[0], min(had[1], seen[1]), max(had[2], seen[2])]
        self.cost.merge(other.cost)
        self.received.merge(other.received)
        for name, series in other.series.items():
            kept = self.series_of(name, series)
            if kept is not None and kept is not series:
                kept.merge(series)
        self.unplotted |= set(itertools.islice(other.unplotted, max(0, MOST_NAMES - len(self.unplotted))))
