"""The open faults of one container, as its thread has them in hand."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from phm.core.model import Fault
from phm.recovery.operator.approval import Approval
from phm.recovery.persistence.state import MAX_REPORTED, PersistedCase


@dataclass(slots=True)
class FaultCase:
    """One open fault. `reported` remembers what was said, to say it once."""

    fault: Fault
    generation: str = field(init=False)
    """Generation of the container (`Generation.name`): nothing is done for the fault in another one before it was found there,
    too. Empty: any."""
    reported: set[str] = field(default_factory=set)
    refused: bool = False
    approval: Approval | None = None
    """Of an operator; holds for one action, and not over a restart of PHM."""
    recheck_from: float | None = None
    """Restored, or the container was started again by others: nothing is done before a run that began after this
    (monotonic seconds) has found the unit in ERROR."""
    on_hold: bool = False
    """Its container was on hold when it was last looked at."""
    interrupted: bool = False
    """Restored, with an action under way: the target is held until it is healed or acted on anew."""

    def __post_init__(self) -> None:
        self.generation = self.fault.life

    def update_fault(self, fault: Fault) -> None:
        """What is wrong may be another thing by now, for which other actions are known."""
        if fault.result.condition != self.fault.result.condition:
            self.refused = False
        self.fault = fault


class FaultCases:
    """By unit. Thread-safe; what stands in a case is the thread's own."""

    def __init__(self, target: str) -> None:
        self._target = target
        self._of: dict[str, FaultCase] = {}
        self._lock = threading.Lock()

    def opened(self, fault: Fault) -> None:
        """A new fault, or new words for one that is in hand."""
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

        They are asked for while no case can come: one that opens meanwhile would be forgotten for ever.
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
        """For the state file, by fault id."""
        with self._lock:
            cases = list(self._of.values())
        return {case.fault.id: _persisted(case) for case in cases}


def _persisted(case: FaultCase) -> PersistedCase:
    approved = case.approval.situation.action if case.approval is not None else ""
    return PersistedCase(case.refused, tuple(sorted(case.reported)[:MAX_REPORTED]), approved)
