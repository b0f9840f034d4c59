"""Faults as episodes: each is opened once, numbered, and closed once with its outcome."""

from __future__ import annotations

from dataclasses import replace

from phm.core.model import Fault, FaultClosed, FaultOpened, Level, Outcome, Result, Stamp
from phm.tracker.start_dedup import StartDedup
from phm.tracker.units import NEVER, Effects, TrackerView, UnitRecord

CONFIGURATION = "configuration"
"""What ended a fault whose unit is no longer configured."""
RESTORED = "restored after a restart of PHM"


class FaultRecords:
    """Opens and closes the faults of all units. Invariant: a unit has at most one open fault."""

    def __init__(self, scene: TrackerView, prefix: str, lives: StartDedup) -> None:
        self._scene, self._prefix, self._lives = scene, prefix, lives
        self._count = 0
        self._taken: frozenset[str] = frozenset()

    def restore(self, faults: tuple[Fault, ...], given_up: tuple[Fault, ...], now: Stamp) -> Effects:
        """See `Tracker.restore`. Ids that an earlier run of PHM gave are not given again."""
        step = Effects()
        self._taken = frozenset(fault.id for fault in (*faults, *given_up))
        for fault in faults:
            entry = self._scene.units.get(fault.unit)
            if entry is None:
                closed = replace(fault, closed=now, outcome=Outcome.RESOLVED, by=CONFIGURATION)
                step.events.append(FaultClosed(now, closed))
            elif entry.fault is None:
                entry.fault = replace(fault, slot=entry.spec.slot, layer=entry.spec.layer)
                entry.conditions.add(fault.result.condition)
                _restored(entry, fault, fault.id)
        for fault in given_up:
            entry = self._scene.units.get(fault.unit)
            if entry is not None and entry.fault is None:
                entry.escalated, entry.given_up = True, fault
                entry.conditions.add(fault.result.condition)
                _restored(entry, fault, "")
        return step

    def open(self, entry: UnitRecord, result: Result, now: Stamp, step: Effects) -> None:
        """An alarm, unless recovery has given up on this unit and it has not been well since; what is wrong in another way than
        before is a new one all the same, once for each condition."""
        if entry.fault is not None or (entry.escalated and result.condition in entry.conditions):
            return
        entry.escalated, entry.given_up = False, None
        entry.conditions.add(result.condition)
        spec = entry.spec
        entry.fault = Fault(
            self._next_id(),
            entry.id,
            spec.slot,
            spec.layer,
            result,
            now,
            consequences=self._consequences(entry),
            suspects=self._suspects(entry),
            ok_s=now.mono - entry.told.since.mono if entry.told.level is Level.OK else 0.0,
            ok_since_start_s=entry.ok_since_start_s(now.mono),
            start_seen=entry.container_started != NEVER,
            life=self._lives.newest(result.target) if result.target else "",
        )
        step.events.append(FaultOpened(now, entry.fault))

    def close(self, entry: UnitRecord, outcome: Outcome, by: str, now: Stamp, step: Effects) -> None:
        if entry.fault is None:
            return
        closed = replace(entry.fault, closed=now, outcome=outcome, by=by)
        entry.fault = None
        entry.told = replace(entry.told, fault="")
        step.events.append(FaultClosed(now, closed))

    def _next_id(self) -> str:
        self._count += 1
        while f"{self._prefix}{self._count}" in self._taken:
            self._count += 1
        return f"{self._prefix}{self._count}"

    def _consequences(self, entry: UnitRecord) -> tuple[str, ...]:
        """Names of the checks that cannot be well while the unit is not, in slot order."""
        below = sorted((other.spec for other in self._scene.downstream(entry.id)), key=lambda spec: spec.slot)
        return tuple(dict.fromkeys(spec.check for spec in below))

    def _suspects(self, entry: UnitRecord) -> tuple[str, ...]:
        """Units told as ERROR that can be behind anything (`Unit.suspect`), such as a full disk."""
        return tuple(
            other.id
            for other in self._scene.units.values()
            if other.spec.unit.suspect and other.told.level is Level.ERROR and other is not entry
        )


def _restored(entry: UnitRecord, fault: Fault, name: str) -> None:
    result = replace(fault.result, level=Level.ERROR, summary=f"{RESTORED}: {fault.result.summary}")
    entry.told = replace(entry.told, level=Level.ERROR, result=result, since=fault.opened, fault=name)
