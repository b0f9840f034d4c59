"""The open faults of one target, as its worker handles them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from phm.core.model import Fault
from phm.recovery.operator.approval import Approval
from phm.recovery.persistence.state import MAX_REPORTED, PersistedCase


@dataclass(slots=True)
class FaultCase:
    """One open fault. reported: the steps that were published, so that each is published once."""

    fault: Fault
    generation: str = field(init=False)
    """Generation of the container (`Generation.name`): nothing is done in another one before the fault was found there,
    too. Empty: any."""
    reported: set[str] = field(default_factory=set)
    refused: bool = False
    approval: Approval | None = None
    """Of an operator, for one action; it ends with PHM."""
    recheck_from: float | None = None
    """Restored, or the container was started again by others: nothing is done before a run that began after this
    (monotonic seconds) has found the unit in ERROR."""
    on_hold: bool = False
    """Whether its container was on hold at the last decision."""
    interrupted: bool = False
    """Restored, with an action under way: its action hold lasts until it recovers or the next action."""

    def __post_init__(self) -> None:
        self.generation = self.fault.generation

    def update_fault(self, fault: Fault) -> None:
        """The condition may have changed, and with it the actions that apply."""
        if fault.result.condition != self.fault.result.condition:
            self.refused = False
        self.fault = fault


class FaultCases:
    """By unit. Thread-safe, but for the contents of a case, which only the worker changes."""

    def __init__(self, target: str) -> None:
        self._target = target
        self._of: dict[str, FaultCase] = {}
        self._lock = threading.Lock()

    def opened(self, fault: Fault) -> None:
        """Take over a new or changed fault."""
        with self._lock:
            case = self._of.get(fault.unit)
            if case is not None and case.fault.id == fault.id:
                case.update_fault(fault)
            else:
                self._of[fault.unit] = FaultCase(fault)

    def put(self, case: FaultCase) -> None:
        with self._lock:
            self._of[case.fault.unit] = case

    def closed(self, unit: str) -> FaultCase | None:
        with self._lock:
            return self._of.pop(unit, None)

    def current(self, open_faults: Callable[[], Iterable[Fault]]) -> list[FaultCase]:
        """The cases as their faults are now, most upstream first. Forgets those that are over, or no longer this target's.

        No case can be added while they are read: it would be forgotten.
        """
        with self._lock:
            mine = {fault.id: fault for fault in open_faults() if fault.result.target == self._target}
            self._of = {unit: case for unit, case in self._of.items() if case.fault.id in mine}
            for case in self._of.values():
                case.update_fault(mine[case.fault.id])
            return sorted(self._of.values(), key=lambda case: case.fault.slot)

    def find(self, fault_id: str) -> FaultCase | None:
        with self._lock:
            return next((case for case in self._of.values() if case.fault.id == fault_id), None)

    def persisted(self) -> dict[str, PersistedCase]:
        """The cases for the state file, by fault id."""
        with self._lock:
            cases = list(self._of.values())
        return {case.fault.id: _persisted(case) for case in cases}


def _persisted(case: FaultCase) -> PersistedCase:
    approved = case.approval.situation.action if case.approval is not None else ""
    return PersistedCase(case.refused, tuple(sorted(case.reported)[:MAX_REPORTED]), approved)
