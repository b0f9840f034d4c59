"""What a report keeps of the events of one segment of a record, in bounded memory. Parts of several processes are merged."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from phm.review import utc_steps
from phm.review.agent_run import MOST_CHECKS, Change, Run, RunMark
from phm.review.events import LATEST_S, Event, numbers
from phm.review.external_entry import EARLIEST_S, KINDS, MOST, ExternalEntry
from phm.review.ground_part import GroundRun
from phm.review.lines import Problems
from phm.review.measurements import PLOTTED

MOST_RUNS = 2000
MOST_UNITS = 1000
MOST_EVENTS = 200_000
"""Of one run and kind; more are counted and left out."""
MOST_VALUES = 100
"""Of one unit, as the evidence of a fault."""
TOO_MANY_RUNS = "more runs of PHM than a report takes"
TOO_MANY_GROUNDS = "more runs of the ground than a report takes"
LARGEST = 1e15
"""No measurement is larger: sums of them stay finite."""
MEASURED = frozenset(("host", "radio", "link", "rates", "autopilot"))
"""Checks whose values are measurements."""
TOO_EARLY = "times before the year 2000, left out: the clock was never set, or the time is simulated (use_sim_time)"


class Part:
    """A part of a record; takes events in the order of the file."""

    def __init__(self) -> None:
        self.runs: dict[tuple[str, str], Run] = {}
        self.grounds: dict[str, GroundRun] = {}
        self.others: list[ExternalEntry] = []
        self.problems = Problems()
        self.lines = 0
        self.bytes = 0
        self._texts: dict[str, str] = {}

    def take(self, event: Event, path: str) -> None:
        self.lines += 1
        if event.boot_id:
            self._line(event, path)
        elif event.run:
            if event.run not in self.grounds and len(self.grounds) >= MOST_RUNS:
                self.problems.add(TOO_MANY_GROUNDS, path)
                return
            self.grounds.setdefault(event.run, GroundRun(event.run)).take(event)
        elif event.event in KINDS:
            self._other(event, path)
        else:
            self.problems.add("neither boot_id nor run: not a record of PHM", path)

    def _other(self, event: Event, path: str) -> None:
        made = ExternalEntry.of(event, path)
        if made is None:
            self.problems.add(
                TOO_EARLY if event.utc_s <= EARLIEST_S else "an entry without a possible time or system, left out", path
            )
        elif len(self.others) >= MOST:
            self.problems.add(f"more than {MOST} entries of other records; the others are left out", path)
        else:
            self.others.append(made)

    def merge(self, other: Part) -> None:
        for key, run in other.runs.items():
            if key in self.runs:
                self.runs[key].merge(run)
            elif len(self.runs) < MOST_RUNS:
                self.runs[key] = run
            else:
                self.problems.add(TOO_MANY_RUNS, min(run.folders, default=""), count=run.lines)
        for name, ground in other.grounds.items():
            if name in self.grounds:
                self.grounds[name].merge(ground)
            elif len(self.grounds) < MOST_RUNS:
                self.grounds[name] = ground
            else:
                self.problems.add(TOO_MANY_GROUNDS, "", count=ground.lines)
        room = MOST - len(self.others)
        self.others += other.others[:room]
        if left_out := len(other.others[room:]):
            self.problems.add(
                f"more than {MOST} entries of other records; the others are left out",
                other.others[-1].file,
                count=left_out,
            )
        self.problems.merge(other.problems)
        self.lines, self.bytes = self.lines + other.lines, self.bytes + other.bytes

    def _line(self, event: Event, path: str) -> None:
        key = (str(event.agent), event.boot_id)
        run = self.runs.get(key)
        if run is None:
            if len(self.runs) >= MOST_RUNS:
                self.problems.add(TOO_MANY_RUNS, path)
                return
            run = self.runs[key] = Run(str(event.agent)[:80], event.agent_id, event.boot_id[:40])
            run.folders.add(os.path.dirname(os.path.abspath(path)))
        run.lines += 1
        run.cover.add(event.mono)
        run.numbers.add(float(event.seq))
        utc_steps.note(run.clock, event.mono, event.utc_s)
        handler = _HANDLERS.get(event.event)
        if handler is not None:
            handler(self, run, event)

    def _same(self, text: str) -> str:
        """One object for equal texts: a summary comes many times."""
        if len(self._texts) > 50_000:
            self._texts.clear()
        return self._texts.setdefault(text, text)

    def _unit(self, run: Run, event: Event) -> None:
        """A unit in a report or at a change: where it belongs, and its measurements."""
        if event.unit not in run.units:
            if len(run.units) >= MOST_UNITS:
                run.left_out += 1
                return
            run.units[event.unit] = {
                "check": event.check or event.unit.partition("/")[0],
                "slot": event.slot,
                "layer": event.layer,
                "target": event.target or "",
                "level": event.old if event.event == "transition" else event.level,
                "at": event.mono,
                "summary": self._same(event.summary[:500]),
            }
        _cause(run, event)
        if event.check in MEASURED:
            _measure(run, event)
        spent_ms = event.duration_ms
        if spent_ms is None or not 0.0 <= spent_ms < LATEST_S:
            return
        if event.check in run.check_ms or len(run.check_ms) < MOST_CHECKS:
            spent = run.check_ms.setdefault(event.check, [0.0, 0.0, 0.0])
            spent[0], spent[1], spent[2] = spent[0] + 1, spent[1] + spent_ms, max(spent[2], spent_ms)

    def _reported(self, run: Run, event: Event) -> None:
        """A unit in a report. Each part's first line of a unit counts as a change: it is not known what the others say."""
        self._unit(run, event)
        if event.unit in run.units and event.level and event.level != run.last_level.get(event.unit):
            self._keep(run.unlogged, run, event)

    def _change(self, run: Run, event: Event) -> None:
        self._unit(run, event)
        self._keep(run.changes, run, event)

    def _keep(self, changes: list[Change], run: Run, event: Event) -> None:
        if len(changes) >= MOST_EVENTS:
            run.left_out += 1
            return
        same = self._same
        run.last_level[event.unit] = same(event.level)
        changes.append(
            Change(
                event.seq,
                event.mono,
                same(event.unit),
                same(event.level),
                same(event.old),
                same(event.summary[:1000]),
                same(event.brief),
                same(event.condition),
                same(event.blocked_by),
                str(event.fault or ""),
                event.changed_text,
                dict(list(numbers(event.values).items())[:MOST_VALUES]) if event.level == "ERROR" else {},
            )
        )

    def _fault(self, run: Run, event: Event) -> None:
        name = str(event.fault or "")
        if not name or (name not in run.faults and len(run.faults) >= MOST_EVENTS):
            run.left_out += 1
            return
        closed = event.event == "fault_closed"
        known = run.faults.setdefault(name, {"opened_at": None, "closed_at": None})
        known.update(
            unit=event.unit,
            slot=event.slot,
            layer=event.layer,
            condition=event.condition,
            summary=event.summary,
            brief=event.brief,
            target=event.target or "",
            outcome=event.outcome or "open",
            by=str(event.by or ""),
            blocks=[self._same(unit) for unit in event.blocks[:MOST_UNITS]],
            consequences=[self._same(unit) for unit in event.consequences[:MOST_UNITS]],
            suspects=[self._same(unit) for unit in event.suspects[:MOST_UNITS]],
            duration_s=event.duration_s,
        )
        if closed:
            known["closed_at"] = event.mono
            if known["opened_at"] is None and event.duration_s is not None:
                known["opened_at"] = event.mono - max(0.0, event.duration_s)
        else:
            known["opened_at"] = event.mono

    def _report(self, run: Run, event: Event) -> None:
        if len(run.reports) < MOST_EVENTS:
            run.reports.append(event.mono)
        if 0.0 <= event.took_s < LATEST_S and len(run.took_at) < MOST_EVENTS:
            run.took_at.append(event.mono)
            run.took_s.append(event.took_s)

    def _start(self, run: Run, event: Event) -> None:
        run.version, run.interval_s, run.started = event.version[:40], event.interval_s, event.mono
        run.machine_boot = event.machine_boot[:40]

    def _received(self, run: Run, event: Event) -> None:
        run.received.take(event.frames)

    def _cost(self, run: Run, event: Event) -> None:
        if event.cpu_s is not None and 0.0 <= event.cpu_s < LATEST_S:
            sent_bytes = min(max(0, sum(event.sent_bytes.values())), int(LARGEST))
            run.cost.add(event.mono, event.cpu_s, sent_bytes, min(max(0, event.memory_bytes), int(LARGEST)))

    def _mark(self, run: Run, event: Event) -> None:
        if len(run.marks) >= MOST_EVENTS:
            run.left_out += 1
            return
        body: dict[str, Any] = {}
        text = event.text
        if event.event == "action":
            body = {
                "fault": str(event.fault or ""),
                "unit": event.unit,
                "action": event.action,
                "phase": event.phase,
                "target": event.target or "",
                "attempt": event.attempt,
            }
            text = event.detail
        elif event.event == "flight":
            body = {
                "number": event.number,
                "began": event.began,
                "continued": event.continued,
                "duration_s": event.duration_s,
            }
        elif event.event == "lost":
            body, text = {"lines": event.lines}, event.reason
        elif event.event == "hold":
            body = {"target": event.target, "began": event.began}
        run.marks.append(
            RunMark(event.seq, event.mono, event.event, self._same(text[:1000]), {"kind": event.kind, **body})
        )


def _cause(run: Run, event: Event) -> None:
    """Why the unit is unknown, if that is new. The first line of a part always is: it is not known what the others say."""
    if run.last_cause.get(event.unit) == event.blocked_by:
        return
    if len(run.causes) >= MOST_EVENTS:
        run.left_out += 1
        return
    run.last_cause[event.unit] = event.blocked_by
    run.causes.append((event.mono, event.unit, event.blocked_by))


def _measure(run: Run, event: Event) -> None:
    for name, value in numbers(event.values).items():
        if isinstance(value, bool):
            if name == "armed" and (not run.armed or run.armed[-1][1] is not value):
                if len(run.armed) < MOST_UNITS:
                    run.armed.append((event.mono, value))
                else:
                    run.left_out += 1
            continue
        if not isinstance(value, (int, float)) or abs(value) > LARGEST:
            continue
        if name == "boot_s":
            _boot(run, event, float(value))
        elif name.startswith(PLOTTED):
            series = run.series_of(f"{event.unit} {name}")
            if series is not None:
                series.add(event.mono, float(value))


def _boot(run: Run, event: Event, boot_s: float) -> None:
    """When the autopilot booted, on the clock of the run. The unit's line is newer than its measurement: hence the least."""
    count = numbers(event.values).get("reboots")
    moment = event.mono - boot_s
    seen = run.boots.setdefault(count if isinstance(count, int) else 0, [0.0, moment, moment])
    seen[0], seen[1], seen[2] = seen[0] + 1, min(seen[1], moment), max(seen[2], moment)


_HANDLERS: dict[str, Callable[[Part, Run, Event], None]] = {
    "start": Part._start,
    "transition": Part._change,
    "unit": Part._reported,
    "fault_opened": Part._fault,
    "fault_closed": Part._fault,
    "report": Part._report,
    "action": Part._mark,
    "flight": Part._mark,
    "hold": Part._mark,
    "note": Part._mark,
    "lost": Part._mark,
    "received": Part._received,
    "cost": Part._cost,
}
