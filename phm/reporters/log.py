"""The log on board: `phm.log` for people and `phm.jsonl`, the record for analysis after flight.

What the lines look like is `phm.reporters.text_log_format` (text) and `docs/reference/logs.md` (JSON keys, a contract); how
they get to the disk is `phm.reporters.rotating_file`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import Any

from phm import __version__
from phm.core.model import (
    ActionEvent,
    Event,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Note,
    Report,
    ReportStarted,
    Slot,
    Stamp,
    Transition,
    UnitState,
    worst_by_slot,
)
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.flights import FlightChange, FlightCounter
from phm.reporters.own_cost import own_cost
from phm.reporters.received_heartbeats import ReceivedHeartbeats
from phm.reporters.rotating_file import RotatingFile
from phm.reporters.text_log_format import MAX_BYTES, TextLogFormatter, closed_kind, encode, note_kind, unit_kind
from phm.wire.json_log import VERSION
from phm.wire.report import clock_text, fault_json, iso, status_array, unit_json
from phm.wire.text import one_line

# An event of more than MAX_BYTES is cut: first to these lengths of text and list, without values.
_CUTS = ((500, 16), (60, 4))


FLIGHT = "FLIGHT"


class LogReporter(Reporter):
    """Text and JSON lines in `log.directory`."""

    name = "log"
    period_s = 0.5
    queue_size = 5000

    def __init__(self, context: ReporterContext) -> None:
        settings = context.settings
        self._context = context
        self._text = TextLogFormatter()
        self._slots: dict[str, Slot] = {}
        self._seq = 0
        self._head = {"agent": settings.agent.name, "agent_id": settings.agent.id, "boot_id": context.boot_id}
        log = settings.log
        size, files, clock = int(log.max_size), log.files, context.clock
        where = log.directory
        self._sync = log.sync
        self._flights = FlightCounter(settings.state_dir)
        self._plain = RotatingFile(
            os.path.join(where, "phm.log"), max_size=size, files=files, clock=clock, lost_line=_lost_text
        )
        self._record = RotatingFile(
            os.path.join(where, "phm.jsonl"),
            max_size=size,
            files=files,
            clock=clock,
            lost_line=_lost_json,
            compress=True,
        )
        self._received = ReceivedHeartbeats(context.mavlink, clock)
        start = {"version": __version__, "pid": os.getpid(), "interval_s": settings.interval_s}
        start["machine_boot"] = context.machine_boot
        # Written by the log's own thread, with its first event or tick: a disk that hangs must not keep PHM from starting.
        self._record.put(self._line(clock.stamp(), "start", "PHM", start))

    @classmethod
    def build(cls, context: ReporterContext) -> LogReporter:
        return cls(context)

    def handle(self, event: Event) -> None:
        sync = self._sync == "always" and isinstance(event, (FaultOpened, FaultClosed, Report))
        # The record first: if the process dies in between, the file for analysis is complete.
        for at, name, kind, body in self._bodies(event):
            self._put(at, name, kind, body, sync=sync and name != "unit")
        for line in self._text.format(event):
            self._plain.write(encode(line), sync=sync)

    def tick(self) -> None:
        armed = self._context.reported_armed()
        change = self._flights.update(armed, self._context.clock.mono())
        if change is not None:
            self._mark(change)
        if frames := self._received.take():
            self._put(self._context.clock.stamp(), "received", "PHM", {"frames": frames})
        self._record.retry()
        self._plain.retry()
        if self._sync == "always" or (self._sync == "auto" and armed is not False):
            self._record.sync()
            self._plain.sync()

    def close(self) -> None:
        self._record.close()
        self._plain.close()

    def problem(self) -> str:
        return self._record.problem() or self._plain.problem()

    def _mark(self, change: FlightChange) -> None:
        at = self._context.clock.stamp()
        duration_s = None if change.duration_s is None else round(change.duration_s, 1)
        body = {"number": change.number, "began": change.began, "continued": change.continued, "duration_s": duration_s}
        self._put(at, "flight", FLIGHT, {**body, "text": change.text})
        self._plain.write(encode(f"{clock_text(at.utc)} ---- {FLIGHT}: {change.text}"))

    def _put(self, at: Stamp, name: str, kind: str, body: dict[str, Any], *, sync: bool = False) -> None:
        self._record.write(self._line(at, name, kind, body), sync=sync)

    def _line(self, at: Stamp, name: str, kind: str, body: dict[str, Any]) -> bytes:
        """The next line of the record."""
        self._seq += 1
        when = {"seq": self._seq, "mono": round(at.mono, 6), "utc": iso(at.utc), "utc_s": round(at.utc, 6)}
        return _dump({"v": VERSION, **self._head, **when, "event": name, "kind": kind, **body})

    def _bodies(self, event: Event) -> Iterator[tuple[Stamp, str, str, dict[str, Any]]]:
        """The JSON lines of one event as (stamp, event, kind, further keys)."""
        at = event.at
        if isinstance(event, Transition):
            state = event.state
            self._slots[state.unit] = state.slot
            body = {**_unit(state), "old": event.old.name, "changed_text": event.changed_text}
            yield at, "transition", unit_kind(state), body
        elif isinstance(event, FaultOpened):
            yield at, "fault_opened", "FAILURE", fault_json(event.fault)
        elif isinstance(event, FaultClosed):
            yield (at, "fault_closed", closed_kind(event.fault.outcome), fault_json(event.fault))
        elif isinstance(event, ActionEvent):
            yield (at, "action", "ESCALATED" if event.phase.value == "escalated" else "ACTION", self._action(event))
        elif isinstance(event, HoldChanged):
            yield at, "hold", "HOLD", _hold(event)
        elif isinstance(event, Note):
            yield at, "note", note_kind(event.kind), {"text": event.text}
        elif isinstance(event, ReportStarted):
            yield at, "report_started", "REPORT", {"number": event.number}
        elif isinstance(event, Report):
            self._slots = {state.unit: state.slot for state in event.units}
            for state in event.units:
                yield (at, "unit", unit_kind(state), {**_unit(state), "number": event.number})
            yield at, "report", "REPORT", _report(event)
            yield at, "cost", "PHM", own_cost(self._context.health())

    def _action(self, event: ActionEvent) -> dict[str, Any]:
        slot = self._slots.get(event.unit)
        return {
            "fault": event.fault,
            "unit": event.unit,
            "slot": None if slot is None else int(slot),
            "action": event.action,
            "target": event.target,
            "phase": event.phase.value,
            "attempt": event.attempt,
            "detail": event.detail,
        }


def _unit(state: UnitState) -> dict[str, Any]:
    body = unit_json(state)
    return {"unit": body.pop("id"), **body}


def _hold(event: HoldChanged) -> dict[str, Any]:
    return {
        "target": event.target or None,
        "began": event.began,
        "by": event.by,
        "reason": event.reason,
        "left_s": round(event.left_s, 1),
        "text": event.text,
    }


def _report(report: Report) -> dict[str, Any]:
    array = status_array(report.units)
    slots = worst_by_slot(report.units)
    return {
        "number": report.number,
        "took_s": round(report.at.mono - report.started.mono, 3),
        "successes": array.count(1),
        "failures": array.count(0),
        "status_array": array,
        "slots": {str(int(slot)): slots[slot].name for slot in sorted(slots)},
        "missing": list(report.missing),
    }


def _dump(event: dict[str, Any]) -> bytes:
    """One line of ASCII JSON (control characters, line separators and lone surrogates come out escaped)."""
    data = _json(event)
    for text, items in _CUTS:
        if len(data) <= MAX_BYTES:
            break
        short = {key: _cut(value, text, items) for key, value in event.items() if key != "values"}
        data = _json({**short, "cut": True})
    return data


def _json(event: dict[str, Any]) -> bytes:
    return json.dumps(event, separators=(",", ":"), default=str).encode("ascii")


def _cut(value: Any, text: int, items: int) -> Any:
    if isinstance(value, str):
        return value[:text]
    if isinstance(value, list):
        return [_cut(entry, text, items) for entry in value[:items]]
    return value


def _lost_text(count: int, reason: str, last: bytes) -> bytes:
    stamp = last[: len(clock_text(0))].decode("utf-8", "replace")
    return encode(one_line(f"{stamp} ---- PHM: {count} lines before this one were lost: {reason}"))


def _lost_json(count: int, reason: str, last: bytes) -> bytes:
    """Replaces the last lost line, with its number and stamps, so that `seq` has no gap."""
    head = json.loads(last)
    kept = {key: head[key] for key in ("v", "agent", "agent_id", "boot_id", "seq", "mono", "utc", "utc_s")}
    return _json({**kept, "event": "lost", "kind": "PHM", "lines": count, "reason": reason})
