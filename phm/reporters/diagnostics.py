"""PHM's units as ROS diagnostics: one status for each unit and a summary, every second and on each change, while a node subscribes.

The daemon does not use ROS: statuses go through a pipe to the ROS child process. When the check scheduler hangs nothing is
published, so subscribers see the statuses become stale.
`docs/reference/ros.md` states names, hardware id and key-values as a contract.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from phm import __version__
from phm.core.model import (
    ActionEvent,
    Event,
    FaultClosed,
    FaultOpened,
    Level,
    Transition,
    UnitState,
    worst_by_slot,
)
from phm.facts.ros import DiagnosticFact
from phm.reporters.base import DiagnosticsPublisher, Reporter, ReporterContext
from phm.reporters.open_faults import OpenFaults
from phm.wire import status_word
from phm.wire.report import NOT_APPLICABLE, array_text, iso, status_array, values_json
from phm.wire.text import one_line

logger = logging.getLogger(__name__)

ALONG_S = 0.1
"""Changes within this time of the last array wait for the next tick, so that a burst costs one array."""
MAX_MESSAGE = 255
MAX_VALUE = 120
MAX_VALUES = 12
"""Measured values of one unit that are published; the log has all of them."""
MAX_UNITS = 500
_NOT_TAKEN = 5


class DiagnosticsReporter(Reporter):
    """Publishes on /diagnostics through the ROS child process."""

    name = "diagnostics"
    period_s = 1.0
    kinds = (Transition, FaultOpened, FaultClosed, ActionEvent)

    def __init__(self, context: ReporterContext, port: DiagnosticsPublisher) -> None:
        self._context, self._agent = context, context.settings.agent
        self._port = port
        self._open = OpenFaults(context.restored)
        self._actions: dict[str, str] = {}
        self._units: dict[str, tuple[UnitState, str, DiagnosticFact]] = {}
        """The last status of each unit, with what it was made of: most units do not change from one array to the next."""
        self._sent_at = float("-inf")
        self._not_taken = 0
        count = len(context.states())
        if count > MAX_UNITS:
            logger.warning(
                "%d of %d units are not on /diagnostics: it has at most %d", count - MAX_UNITS, count, MAX_UNITS
            )

    @classmethod
    def build(cls, context: ReporterContext) -> DiagnosticsReporter | None:
        if context.ros is None or not context.settings.ros.publishes:
            return None
        return cls(context, context.ros)

    def handle(self, event: Event) -> None:
        self._actions.pop(self._open.take(event), None)
        if isinstance(event, ActionEvent) and event.fault in self._open:
            self._actions[event.fault] = f"{event.action} {event.phase.value}"
        if self._context.clock.mono() - self._sent_at >= ALONG_S:
            self.tick()

    def tick(self) -> None:
        if self._context.alive() and not self._port.idle():
            self._send(self._statuses(self._context.states()))

    def close(self) -> None:
        """Publish a last array in which all is STALE, so that subscribers need not wait for their timeouts."""
        last = self._statuses(self._context.states())
        gone = DiagnosticFact(0.0, int(Level.STALE), "PHM has stopped", self._agent.name)
        self._send(dict.fromkeys(last, gone))

    def hand_over(self) -> None:
        """Send nothing: the next reporter continues."""

    def problem(self) -> str:
        if self._not_taken < _NOT_TAKEN:
            return ""
        return (
            f"/diagnostics is not published: the ROS child process has not accepted the last {self._not_taken} arrays"
        )

    def _send(self, statuses: dict[str, DiagnosticFact]) -> None:
        self._sent_at = self._context.clock.mono()
        self._not_taken = self._port.publish(statuses)

    def _statuses(self, states: Sequence[UnitState]) -> dict[str, DiagnosticFact]:
        prefix = f"phm/{self._agent.name}"
        statuses = {f"{prefix}: summary": self._summary(states)}
        statuses |= {f"{prefix}/{state.layer.value}: {state.unit}": self._unit(state) for state in states[:MAX_UNITS]}
        return statuses

    def _unit(self, state: UnitState) -> DiagnosticFact:
        action = self._actions.get(state.fault, "")
        before = self._units.get(state.unit)
        if before is not None and before[1] == action and _same(before[0], state):
            return before[2]
        status = self._status(state, action)
        self._units[state.unit] = (state, action, status)
        return status

    def _status(self, state: UnitState, action: str) -> DiagnosticFact:
        result = state.result
        message = f"{NOT_APPLICABLE}: {result.summary}" if state.not_applicable else result.summary
        known: dict[str, Any] = {
            "unit": state.unit,
            "check": state.check,
            "slot": int(state.slot),
            "since": iso(state.since.utc),
            "condition": result.condition,
            "blocked_by": state.blocked_by,
            "fault": state.fault,
            "action": action,
            "target": result.target,
        }
        measured = list(values_json(result.values).items())[:MAX_VALUES]
        values = {**dict(measured), **known}
        ordered = {key: _text(values[key]) for key in (*known, *(key for key, _ in measured if key not in known))}
        return DiagnosticFact(0.0, int(state.level), self._cut(message), self._hardware, ordered)

    def _summary(self, states: Sequence[UnitState]) -> DiagnosticFact:
        level = max((state.level for state in states), key=lambda level: level.severity, default=Level.STALE)
        evaluated = [state for state in states if not state.not_applicable]
        count = {kind: sum(1 for state in evaluated if state.level is kind) for kind in Level}
        values = {
            "agent_id": self._agent.id,
            "version": __version__,
            "boot_id": self._context.boot_id,
            "status_array": array_text(status_array(states)),
            "status_word": f"0x{status_word.encode(worst_by_slot(tuple(states))):08X}",
            "open_faults": len(self._open),
            **{kind.name.lower(): number for kind, number in count.items()},
            "not_applicable": len(states) - len(evaluated),
        }
        message = self._open_words() or f"{count[Level.OK]} of {len(evaluated)} units are OK"
        texts = {key: _text(value) for key, value in values.items()}
        return DiagnosticFact(0.0, int(level), self._cut(message), self._hardware, texts)

    def _open_words(self) -> str:
        words = [fault.result.brief or fault.unit for fault in self._open.values()]
        return f"{len(words)} open fault{'s' if len(words) > 1 else ''}: {', '.join(words)}" if words else ""

    @property
    def _hardware(self) -> str:
        return self._agent.name

    @staticmethod
    def _cut(text: str) -> str:
        line = one_line(text)
        return line if len(line) <= MAX_MESSAGE else f"{line[: MAX_MESSAGE - 3]}..."


def _same(one: UnitState, other: UnitState) -> bool:
    """Whether both give the same status: they may differ in when their check ran."""
    return one is other or (
        one.result == other.result
        and (one.level, one.since, one.blocked_by, one.fault)
        == (other.level, other.since, other.blocked_by, other.fault)
    )


def _text(value: Any) -> str:
    """Numbers as in JSON, so that plots can read them; booleans as `true` and `false`."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return one_line(str(value))[:MAX_VALUE]
