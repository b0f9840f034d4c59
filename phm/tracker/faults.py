"""Open, number and close faults."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from phm.core.model import Fault, FaultClosed, FaultOpened, Level, Outcome, Result, Stamp
from phm.tracker.start_dedup import StartDedup
from phm.tracker.units import NEVER, Effects, TrackerView, UnitRecord

ITSELF = "itself"
"""`Fault.by` of a fault that no action of PHM ended."""
CONFIGURATION = "configuration"
"""`Fault.by` of a fault whose unit is no longer configured."""
TIMEOUT = "timeout"
"""`Fault.by` of a restored fault whose subject was not observed for UNOBSERVED_S."""
UNOBSERVED_S = 3600.0
"""How long a restored fault stays open without an observation of its subject: longer than most flights. Not for good, because the
subject may have been removed on purpose."""
MOST_NAMES = 8
"""So many subjects are named that were not observed; of the others, the number."""
MOST_COUNTED = 10_000
"""A start of PHM after as many faults begins at 1 again: a line of the ground has 50 characters."""
RESTORED = "restored after a restart of PHM"


class FaultRecords:
    """The faults of all units. Invariant: a unit has at most one open fault."""

    def __init__(self, view: TrackerView, prefix: str, starts: StartDedup) -> None:
        self._view, self._prefix, self._starts = view, prefix, starts
        self.count = 0
        """The number of the last fault. The ground names a fault by its number alone."""
        self._taken: frozenset[int] = frozenset()

    def restore(self, faults: tuple[Fault, ...], given_up: tuple[Fault, ...], count: int, now: Stamp) -> Effects:
        """See `Tracker.restore`. count: of the earlier run of PHM, continued, as the ground may still show its numbers; those of
        restored faults are not used again."""
        effects = Effects()
        self._taken = frozenset(_number(fault.id) for fault in (*faults, *given_up))
        self.count = _continued(count, self._taken)
        for fault in faults:
            record = self._view.units.get(fault.unit)
            if record is None:
                closed = replace(fault, closed=now, outcome=Outcome.RESOLVED, by=CONFIGURATION)
                effects.events.append(FaultClosed(now, closed))
            elif record.fault is None:
                record.fault = replace(
                    fault, slot=record.spec.slot, layer=record.spec.layer, node=record.spec.unit.node
                )
                record.conditions.add(fault.result.condition)
                _restored(record, fault, fault.id, now)
        for fault in given_up:
            record = self._view.units.get(fault.unit)
            if record is not None and record.fault is None:
                record.escalated, record.given_up = True, fault
                record.conditions.add(fault.result.condition)
                _restored(record, fault, "", now)
        return effects

    def open(self, record: UnitRecord, result: Result, now: Stamp, effects: Effects, by: str = "") -> None:
        """Open a fault, unless recovery has given up on this unit and it has not been OK since. A new condition opens a new fault
        all the same, once for each condition. by: an action in progress on its target that may end it."""
        if record.fault is not None or (record.escalated and result.condition in record.conditions):
            return
        record.escalated, record.given_up = False, None
        record.conditions.add(result.condition)
        spec = record.spec
        record.fault = Fault(
            self._next_id(),
            record.id,
            spec.slot,
            spec.layer,
            result,
            now,
            by=by,
            consequences=self._consequences(record),
            suspects=self._suspects(record),
            ok_s=max(record.longest_ok_s, _present_ok_s(record, now)),
            ok_since_start_s=record.ok_since_start_s(now.mono),
            ok_in_run_before_s=record.ok_in_run_before_s,
            start_seen=record.container_started != NEVER,
            pause_s=record.pause_s,
            generation=self._starts.newest(result.target) if result.target else "",
            node=spec.unit.node,
            confirmed_s=None if record.error_since is None else max(0.0, now.mono - record.error_since),
        )
        record.longest_ok_s = 0.0
        effects.events.append(FaultOpened(now, record.fault))

    def close(self, record: UnitRecord, outcome: Outcome, by: str, now: Stamp, effects: Effects) -> None:
        if record.fault is None:
            return
        closed = replace(record.fault, closed=now, outcome=outcome, by=by)
        record.fault = None
        restarted = record.container_started > closed.opened.mono
        if outcome is Outcome.RESOLVED and by == ITSELF and not restarted:
            record.pause_s = max(record.pause_s, now.mono - closed.opened.mono)
        record.published = replace(record.published, fault="")
        effects.events.append(FaultClosed(now, closed))

    def _next_id(self) -> str:
        self.count += 1
        while self.count in self._taken:
            self.count += 1
        return f"{self._prefix}{self.count}"

    def _consequences(self, record: UnitRecord) -> tuple[str, ...]:
        """Names of the checks that cannot be OK while this unit is not, in slot order."""
        below = sorted((other.spec for other in self._view.downstream(record.id)), key=lambda spec: spec.slot)
        return tuple(dict.fromkeys(spec.check for spec in below))

    def _suspects(self, record: UnitRecord) -> tuple[str, ...]:
        """Units in ERROR that can cause any fault (`Unit.suspect`), such as a full disk."""
        return tuple(
            other.id
            for other in self._view.units.values()
            if other.spec.unit.suspect and other.published.level is Level.ERROR and other is not record
        )


def _number(fault_id: str) -> int:
    """The number at the end of an id; 0: none. The state file may have been damaged."""
    found = re.search(r"[0-9]{1,9}$", fault_id)
    return int(found[0]) if found else 0


def _continued(count: int, taken: Iterable[int]) -> int:
    """Where the numbers go on. State files of earlier versions have no count: then after the restored faults."""
    if count >= MOST_COUNTED:
        return 0
    return max(0, count, *(number for number in taken if number < MOST_COUNTED))


def _present_ok_s(record: UnitRecord, now: Stamp) -> float:
    return now.mono - record.published.since.mono if record.published.level is Level.OK else 0.0


def as_unobserved(result: Result, subjects: Iterable[str]) -> Result:
    """The result of a check that has not observed all since PHM's start, for a unit with a restored fault. subjects: those missing."""
    names = sorted(subjects)
    more = [f"+{len(names) - MOST_NAMES}"] if len(names) > MOST_NAMES else []
    words = " ".join([*names[:MOST_NAMES], *more, "not observed since PHM was restarted"])
    return replace(result, level=Level.STALE, summary=f"{words}: {result.summary}", bypass=False)


def _restored(record: UnitRecord, fault: Fault, name: str, now: Stamp) -> None:
    result = replace(fault.result, level=Level.ERROR, summary=f"{RESTORED}: {fault.result.summary}")
    record.published = replace(record.published, level=Level.ERROR, result=result, since=fault.opened, fault=name)
    record.reported, record.unobserved_until = True, now.mono + UNOBSERVED_S
    record.restored_subjects = frozenset(fault.result.evidence.subjects or ())
