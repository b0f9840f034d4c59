"""Builds the lines of `phm.wire.status_line` from events.

The ground gets each change once, with the text of its cause; a consequence of another fault is not reported. The only state is
what was sent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace

from phm.core.model import (
    ON_HOLD,
    ActionEvent,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Level,
    Outcome,
    Phase,
    Slot,
    Transition,
    UnitState,
)
from phm.transport.priority import MessagePriority
from phm.wire import command, status_line
from phm.wire.status_line import Severity

FULL_LINES = 10
"""Failing units that are sent one by one to a new ground station; the others are counted in the refresh line."""


@dataclass(frozen=True, slots=True)
class StatusTextLine:
    """`key`: a newer line with the same key replaces this one while it waits."""

    key: str
    severity: Severity
    text: str
    kind: MessagePriority = MessagePriority.TRANSITION
    only_while: tuple[str, ...] = ()
    """While it waits for a link's budget, it is sent only if all of these are true."""


def while_bad(unit: str) -> str:
    """A failure is true while its unit is bad: it may be unknown, on hold or a consequence of another fault by now."""
    return f"bad {unit}"


def while_asked(unit: str) -> str:
    """A request is true until it is answered or the fault of its unit has ended."""
    return f"asked {unit}"


class StatusTextBuilder:
    """Builds lines from events. `_sent` holds, by unit, the last failure that was sent and has not been resolved."""

    def __init__(self, agent: int, approval_s: float | None = None) -> None:
        """approval_s: how long an approval is valid."""
        self._agent, self._approval_s = agent, approval_s
        self._sent: dict[str, tuple[UnitState, str]] = {}
        self._again: set[str] = set()
        """Units whose failure is sent again, also with the same text: it is another one, or was on hold meanwhile."""
        self._open: set[str] = set()
        self._asks: dict[str, StatusTextLine] = {}
        """By unit, the request to the operator that is not answered."""

    def restore_reported(self, states: Sequence[UnitState]) -> None:
        """The ground received the failures of these units from an earlier run of PHM."""
        for state in states:
            self._open.add(state.unit)
            self._bad(state)

    def transition(self, event: Transition) -> list[StatusTextLine]:
        state = event.state
        if state.level.bad:
            return self._bad(state)
        if state.level is Level.OK and state.unit not in self._open:
            return self._over(state.unit, "")
        if state.result.condition == ON_HOLD:
            self._again.add(state.unit)
        return []  # STALE is not reported; OK with an open fault is reported with the end of the fault, and by what it ended

    def fault(self, event: FaultOpened | FaultClosed) -> list[StatusTextLine]:
        fault = event.fault
        if isinstance(event, FaultOpened):
            self._open.add(fault.unit)
            self._again.add(fault.unit)  # the line follows with the transition
            return []
        self._open.discard(fault.unit)
        if fault.outcome is not Outcome.ESCALATED:
            self._asks.pop(fault.unit, None)
        return self._over(fault.unit, fault.by or "itself") if fault.outcome is Outcome.RESOLVED else []

    def hold(self, event: HoldChanged) -> list[StatusTextLine]:
        for_s = event.left_s if event.began else None
        text = status_line.hold(self._agent, Slot.CONTAINER, event.target, for_s, event.reason)
        return [StatusTextLine(f"hold {event.target}", Severity.NOTICE, text)]

    def action(self, event: ActionEvent, states: Mapping[str, UnitState]) -> list[StatusTextLine]:
        """Only requests to the operator; an action of PHM is reported by its result."""
        state = states.get(event.unit)
        if state is None:
            return []
        key = f"{event.unit} action"
        if not event.fault:
            return self._asked(event, state, key)
        number = command.fault_number(event.fault)
        if event.phase is Phase.ADVISED:
            text = status_line.advise(self._agent, state.slot, event.action, event.target, number, self._approval_s)
            return [self._ask(event.unit, StatusTextLine(key, Severity.WARNING, text))]
        if event.phase is Phase.APPROVED:
            self._asks.pop(event.unit, None)
            text = status_line.approved(self._agent, state.slot, event.action, event.target)
            return [StatusTextLine(key, Severity.NOTICE, text)]
        if event.phase is Phase.EXPIRED:
            text = status_line.expired(self._agent, state.slot, event.action, event.target)
            return [StatusTextLine(f"{event.unit} approval", Severity.WARNING, text)]
        if event.phase is Phase.ESCALATED:
            text = status_line.gave_up(self._agent, state.slot, event.target, status_line.brief_of(state), number)
            return [self._ask(event.unit, StatusTextLine(key, status_line.severity(Level.ERROR, state.slot), text))]
        return []

    def asked(self) -> Set[str]:
        """The units with a request to the operator that is not answered."""
        return self._asks.keys()

    def _ask(self, unit: str, line: StatusTextLine) -> StatusTextLine:
        self._asks[unit] = replace(line, only_while=(while_asked(unit),))
        return self._asks[unit]

    def _asked(self, event: ActionEvent, state: UnitState, key: str) -> list[StatusTextLine]:
        """The result of an operator's request without a fault; its beginning was acknowledged."""
        ends = {Phase.VERIFIED: "done", Phase.FAILED: "failed", Phase.REFUSED: "refused"}
        if event.phase not in ends:
            return []
        severity = Severity.NOTICE if event.phase is Phase.VERIFIED else Severity.WARNING
        text = status_line.operator_request(self._agent, state.slot, event.action, ends[event.phase], event.target)
        return [StatusTextLine(key, severity, text)]

    def reconcile(self, states: Sequence[UnitState]) -> list[StatusTextLine]:
        """The lines of lost events; none, if no event was lost."""
        self._open = {state.unit for state in states if state.fault}
        lines = []
        for state in states:
            if state.level.bad:
                lines += self._bad(state)
            elif state.level is Level.OK and not state.fault:
                lines += self._over(state.unit, "")
        return lines

    def full(self, states: Sequence[UnitState]) -> list[StatusTextLine]:
        """All failures again, worst first, for a new ground station, and what waits for the operator, also while its unit is unknown:
        at most one request for each unit, until it is OK."""
        ranked = status_line.worst_first(states)
        lines = []
        for state in [state for state in ranked if state.level.bad][:FULL_LINES]:
            self._sent.pop(state.unit, None)
            lines += self._bad(state)
        lines += [self._asks[state.unit] for state in ranked if state.unit in self._asks]
        return [*(replace(line, kind=MessagePriority.STATE) for line in lines), self.refresh(states)]

    def refresh(self, states: Sequence[UnitState]) -> StatusTextLine:
        return StatusTextLine(
            "refresh", Severity.INFO, status_line.refresh(self._agent, states), MessagePriority.REFRESH
        )

    def _bad(self, state: UnitState) -> list[StatusTextLine]:
        text = status_line.failing(self._agent, state.level, state.slot, status_line.brief_of(state))
        sent = self._sent.get(state.unit)
        self._sent[state.unit] = (state, text)
        if sent is not None and sent[1] == text and state.unit not in self._again:
            return []
        self._again.discard(state.unit)
        severity = status_line.severity(state.level, state.slot)
        return [StatusTextLine(state.unit, severity, text, only_while=(while_bad(state.unit),))]

    def _over(self, unit: str, by: str) -> list[StatusTextLine]:
        self._asks.pop(unit, None)
        self._again.discard(unit)
        sent = self._sent.pop(unit, None)
        if sent is None:
            return []
        state = sent[0]
        subject = status_line.subject_of(state)
        if any(
            other.slot is state.slot and status_line.subject_of(other) == subject for other, _ in self._sent.values()
        ):
            subject = ""  # ambiguous: another unit with this name is still failing
        text = status_line.recovered(self._agent, state.slot, status_line.brief_of(state), by, subject)
        return [StatusTextLine(unit, status_line.severity(Level.OK, state.slot), text)]
