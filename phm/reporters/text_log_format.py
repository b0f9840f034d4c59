"""The lines of the text log, in the format of the PHM paper's Fig. 5.

``2026-03-01 12:00:00.123 ---- KIND: (slot) message``. `docs/reference/logs.md` is the contract.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.model import (
    ActionEvent,
    Event,
    Fault,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Level,
    Note,
    Outcome,
    Phase,
    Report,
    ReportStarted,
    Slot,
    Stamp,
    Transition,
    UnitState,
)
from phm.wire.report import array_text, clock_text, status_array
from phm.wire.text import one_line

MAX_BYTES = 8000
"""A line is cut here: text from outside is not bounded, and a line must fit into the smallest log."""

NOTE_KINDS = ("ACTION", "COMMAND", "DOCKER", "HOLD", "NOTE", "PHM")
_KINDS = {Level.OK: "SUCCESS", Level.WARN: "WARNING", Level.ERROR: "FAILURE", Level.STALE: "STALE"}
# Several OK units of one check in one line: what they are, and their state.
_HEALTHY = {
    Slot.CONTAINER: ("containers", "are OK"),
    Slot.FILES: ("file checks", "passed"),
    Slot.NETWORK: ("network checks", "passed"),
    Slot.DEVICES: ("device checks", "passed"),
    Slot.NODES: ("required nodes", "are running"),
    Slot.TOPICS: ("required topics", "are present"),
    Slot.RATES: ("topics", "have their rate"),
    Slot.HOST: ("host limits", "are kept"),
}
# For checks that share a slot with another.
_HEALTHY_CHECKS = {"diagnostics": ("watched diagnostics", "report OK")}
_REMEMBERED = 64


def unit_kind(state: UnitState) -> str:
    """The log's word for a unit: SUCCESS, BYPASS, WARNING, FAILURE or STALE."""
    return "BYPASS" if state.not_applicable else _KINDS[state.level]


def closed_kind(outcome: Outcome) -> str:
    return {Outcome.ESCALATED: "ESCALATED", Outcome.REATTRIBUTED: "STALE"}.get(outcome, "RESOLVED")


def note_kind(kind: str) -> str:
    return kind if kind in NOTE_KINDS else "PHM"


def encode(line: str) -> bytes:
    """UTF-8, cut to MAX_BYTES at a whole character, with a mark where it was cut."""
    data = line.encode("utf-8", "backslashreplace")
    if len(data) <= MAX_BYTES:
        return data
    return data[: MAX_BYTES - 6].decode("utf-8", "ignore").encode() + b" [cut]"


class TextLogFormatter:
    """Turns events into lines. Its state: slots of units, open faults, logged escalations."""

    def __init__(self) -> None:
        self._slots: dict[str, Slot] = {}
        self._escalated: DuplicateFilter[str, bool] = DuplicateFilter(_REMEMBERED)
        self._faults: dict[str, Fault] = {}
        self._open_report: int | None = None

    def format(self, event: Event) -> list[str]:
        """The lines for one event; none for what another line already shows."""
        return [one_line(line) for line in self._lines(event)]

    def _lines(self, event: Event) -> Iterator[str]:
        if isinstance(event, Transition):
            self._slots[event.unit] = event.state.slot
            # During a report, a unit that becomes OK is listed in it a moment later.
            if not (self._open_report is not None and (event.old, event.new) == (Level.STALE, Level.OK)):
                yield _unit_line(event.at, event.state, self._faults.get(event.unit))
        elif isinstance(event, ReportStarted):
            yield from self._begin(event.at, event.number)
        elif isinstance(event, Report):
            yield from self._report(event)
        elif isinstance(event, ActionEvent):
            yield from self._action(event)
        elif isinstance(event, FaultOpened):
            self._faults[event.fault.unit] = event.fault
        elif isinstance(event, FaultClosed):
            self._faults.pop(event.fault.unit, None)
            yield from self._closed(event)
        elif isinstance(event, HoldChanged):
            yield _line(event.at, "HOLD", None, event.text)
        elif isinstance(event, Note):
            yield _line(event.at, note_kind(event.kind), None, event.text)

    def _begin(self, at: Stamp, number: int) -> Iterator[str]:
        self._open_report = number
        yield f"{clock_text(at.utc)} ---- Start of a new report"

    def _report(self, report: Report) -> Iterator[str]:
        if self._open_report != report.number:
            yield from self._begin(report.started, report.number)
        self._open_report = None
        self._slots = {state.unit: state.slot for state in report.units}
        for _check, states in groupby(report.units, key=lambda state: (state.check, state.slot)):
            yield from _check_lines(report.at, tuple(states), self._faults)
        if report.missing:
            yield _line(
                report.at, "PHM", None, f"not in this report, its check has not returned: {', '.join(report.missing)}"
            )
        array = status_array(report.units)
        yield (
            f"{clock_text(report.at.utc)} REPORT Successes: {array.count(1)}, Failures: {array.count(0)}, "
            f"Status Array: {array_text(array)}"
        )

    def _action(self, event: ActionEvent) -> Iterator[str]:
        kind = "ACTION"
        message = event.detail or _action_words(event)
        if event.phase is Phase.ESCALATED:
            if self._escalated.get(event.fault):
                return
            self._escalated.add(event.fault, True)
            kind, message = "ESCALATED", f"{event.unit}: {message}"
        elif event.phase is Phase.FAILED:
            message = f"failed: {message}"
        elif event.phase is Phase.STARTED and event.attempt > 1:
            message += f" (attempt {event.attempt})"
        yield _line(event.at, kind, self._slots.get(event.unit), message)

    def _closed(self, event: FaultClosed) -> Iterator[str]:
        fault = event.fault
        end = fault.closed or event.at
        after = f"after {end.mono - fault.opened.mono:.1f} s"
        if fault.outcome is Outcome.RESOLVED:
            by = "by itself" if fault.by in ("", "itself") else f"by {fault.by}"
            yield _line(event.at, "RESOLVED", fault.slot, f"{fault.unit}: resolved {by} {after}")
        elif fault.outcome is Outcome.ESCALATED and not self._escalated.get(fault.id):
            self._escalated.add(fault.id, True)
            yield _line(event.at, "ESCALATED", fault.slot, f"{fault.unit}: PHM has given up {after}")
        # REATTRIBUTED needs no line: the unit's own `STALE ... blocked by` shows it.


def _line(at: Stamp, kind: str, slot: Slot | None, message: str) -> str:
    return f"{clock_text(at.utc)} ---- {kind}: {f'({int(slot)}) ' if slot else ''}{message}"


def _action_words(event: ActionEvent) -> str:
    """For an action whose author gave no sentence, e.g. ``restart ros_app for nodes/agent_1/node_1: started``."""
    what = " ".join(part for part in (event.action, event.target) if part)
    return f"{what} for {event.unit}: {event.phase.value}" if event.unit else f"{what}: {event.phase.value}"


def _unit_line(at: Stamp, state: UnitState, fault: Fault | None = None) -> str:
    message = _message(state)
    # The fault of a unit that is OK again closes a moment later; it blocks nothing any more.
    if fault is not None and fault.id == state.fault and state.level is not Level.OK:
        more = following(fault, state.result.summary)
        message = message.rstrip(".") + more if more else message
    return _line(at, unit_kind(state), state.slot, message)


def following(fault: Fault, text: str) -> str:
    """What follows a fault's sentence `text`: its consequences, and other failures that could be its cause.

    ``: blocks nodes, topics, rates; possible cause: host/disk``; ``; blocks ...`` after a sentence that has its colon.
    """
    parts = []
    if fault.consequences:
        parts.append(f"{';' if ': ' in text else ':'} blocks {', '.join(fault.consequences)}")
    if fault.suspects:
        parts.append(f"; possible cause: {', '.join(fault.suspects)}")
    return "".join(parts)


def _message(state: UnitState) -> str:
    summary = state.result.summary
    if state.level is not Level.STALE:
        return summary
    cause = f"blocked by {state.blocked_by}"
    return f"{state.unit}: {summary if not state.blocked_by or summary.startswith(cause) else cause}"


def _check_lines(at: Stamp, states: Sequence[UnitState], faults: Mapping[str, Fault]) -> Iterator[str]:
    """The units of one check: those that are OK in one line, at the place of the first; the others one by one."""
    judged = [state for state in states if unit_kind(state) != "BYPASS"]
    healthy = [state for state in judged if state.level is Level.OK]
    folded = len(healthy) > 1
    for state in states:
        if not folded or state not in healthy:
            yield _unit_line(at, state, faults.get(state.unit))
        elif state is healthy[0]:
            yield _line(at, "SUCCESS", state.slot, _folded(healthy, len(judged)))


def _folded(healthy: Sequence[UnitState], of_all: int) -> str:
    first = healthy[0]
    words = _HEALTHY_CHECKS.get(first.check) or _HEALTHY.get(first.slot)
    what, how = words or (f"units of {first.check}", "are OK")
    count = f"All {of_all}" if len(healthy) == of_all else f"{len(healthy)} of {of_all}"
    return f"{count} {what} {how}: {', '.join(map(_named, healthy))}"


def _named(state: UnitState) -> str:
    """The subject, with its rate where the check measured one, as in Fig. 5: ``agent_1/topic_2: 0.999``."""
    name = state.unit.partition("/")[2] or state.unit
    hz = state.result.values.get("hz") if state.slot is Slot.RATES else None
    return f"{name}: {hz:.3f}" if isinstance(hz, float) else name
