"""Records of the tracker: one per unit, and what one call to the tracker returns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from phm.api import Unit
from phm.core.dependency_graph import DependencyGraph
from phm.core.model import Event, Fault, Layer, Level, Result, Slot, UnitState

NEVER = float("-inf")


@dataclass(frozen=True, slots=True)
class TrackedUnit:
    """A unit with the attributes of its check."""

    unit: Unit
    check: str
    slot: Slot
    layer: Layer
    failures: int = 1
    needs: tuple[str, ...] = ()
    """All dependencies: the unit's own and those that the configuration adds."""
    starved_by: tuple[str, ...] = ()
    """Pressure units that can explain its symptoms: of its container, of the containers it depends on, of the host."""


@dataclass(slots=True)
class Effects:
    """Result of one call: events for the bus, in order, and units whose checks must run again."""

    events: list[Event] = field(default_factory=list)
    rerun: set[str] = field(default_factory=set)
    waiting: bool = True
    """Whether time alone can change something: after `observe` for the unit and its dependents, after `tick` for all units."""


@dataclass(slots=True)
class ActionInProgress:
    """A recovery action on a target. `until` ends it even if its thread has died; both times in monotonic seconds."""

    owner: str
    action: str
    begun: float
    until: float
    verifying: bool = False
    """The owner's OK is not published until the action is verified for its dependents, too."""
    leaves_running: bool = False
    """As `Action.leaves_running`."""
    needed: bool = True
    """It has not found that there is nothing to do."""


@dataclass(frozen=True, slots=True)
class TargetHold:
    """A target is on hold: bad results are published as STALE with `words` and open no fault.

    conditions: limits this to these conditions and to units without an open fault (a container exit that may be part of a
    restart). Empty: all conditions.
    """

    words: str
    conditions: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Pending:
    """A bad result that waits for confirmation, since a moment (monotonic seconds)."""

    since: float
    requested: bool = False
    """The final runs of its dependencies have been requested."""
    again_from: float = NEVER
    """When a failure of a dependency last ended: a run that began later must find the unit bad."""


@dataclass(frozen=True, slots=True)
class Starvation:
    """A resource shortage at a pressure unit: since when, last confirmed when (monotonic seconds), and its condition. below_from: since when
    the measurements are below the limit, while the unit still reports the shortage; None: they are not.
    """

    since: float
    seen: float
    condition: str
    below_from: float | None = None


@dataclass(slots=True)
class UnitRecord:
    """Everything known about one unit. `latest` is its newest result; `started` is when that run began."""

    spec: TrackedUnit
    published: UnitState
    latest: Result | None = None
    started: float = NEVER
    ended_by: str = ""
    """What ended its last failure, as a result since then stated (`Evidence.ended_by`); empty: none did, or it fails again."""
    duration_s: float = 0.0
    """How long the run of the newest result took."""
    published_from: Result | None = None
    """The newest result when `published` was published."""
    bad_in_a_row: int = 0
    error_since: float | None = None
    """Start of the first run of the present series of ERROR results that count."""
    certain_since: float | None = None
    """When the first of the present series of certain bad results was observed."""
    pending: Pending | None = None
    had_error: bool = False
    """It has been ERROR, published or not, since it was last OK: its dependents may have been affected."""
    reported: bool = False
    """That ERROR was published, or an ERROR of the unit that blocked it."""
    valid_from: float = NEVER
    """Bad results of runs that began earlier do not count."""
    grace_until: float = 0.0
    """End of grace: until then a bad result is published as `not known yet`."""
    had_doubt: bool = False
    """It got grace after a failure of a dependency that was never published, and has not been OK since."""
    unobserved_until: float = NEVER
    """A fault was restored: until then a result without an observation (`Evidence.unobserved`) is STALE, not OK."""
    restored_subjects: frozenset[str] = frozenset()
    """What that fault is about (`Evidence.subjects`): an OK that does not cover all of them is not an observation either."""
    ok_since: float | None = None
    container_started: float = NEVER
    """When its container was last observed to start."""
    ok_before_s: float = 0.0
    """Total time published as OK since that start, without the current period."""
    ok_in_run_before_s: float = 0.0
    """Total time published as OK in the run of the container before, if PHM ended that one."""
    longest_ok_s: float = 0.0
    """The longest period published as OK since that start and since its last fault opened, without the current one."""
    unverified_from: float = NEVER
    unverified_until: float = NEVER
    """Its recovery did not bring back its dependents; until then its OK is not published."""
    fault: Fault | None = None
    pause_s: float = 0.0
    """The longest of its faults that ended by itself, without a start of its container."""
    escalated: bool = False
    given_up: Fault | None = None
    """The fault that recovery gave up on, while `escalated`."""
    starving: Starvation | None = None
    """Of a pressure unit: the shortage that explains symptoms of other units."""
    pressure_unit: str = ""
    """The pressure unit that last affected it."""
    symptoms_count_from: float = NEVER
    """When starvation last ended: symptoms with older evidence do not count."""
    symptom_grace_from: float = NEVER
    """The same until the unit was OK for a while: since then symptoms have time to disappear."""
    conditions: set[str] = field(default_factory=set)
    """Conditions of its faults since it was last OK: giving up on one must not hide another."""

    @property
    def id(self) -> str:
        return self.spec.unit.id

    @property
    def target(self) -> str:
        return self.spec.unit.target

    def note_certain(self, result: Result, started: float) -> None:
        """A run that began at `started` gave this result."""
        if not (result.level.bad and result.evidence.certain):
            self.certain_since = None
        elif self.certain_since is None:
            self.certain_since = min(started, result.evidence.observed)

    def note_end(self, result: Result) -> None:
        """A check states only for a time what ended the failure; while that is verified, no longer perhaps."""
        if result.ends_fault:
            self.ended_by = result.evidence.ended_by or self.ended_by
        elif result.level.bad:
            self.ended_by = ""

    def grant(self, now: float, until: float) -> None:
        """Start grace until then; bad results from before `now` no longer count."""
        self.pending = self.ok_since = self.error_since = self.certain_since = None
        self.bad_in_a_row, self.valid_from = 0, now
        self.grace_until = max(self.grace_until, until)

    def ask_again(self, now: float) -> None:
        """Bad results from before `now` no longer count; what waits for confirmation only needs a newer one."""
        if self.pending is None:
            self.valid_from = now
        else:
            self.pending = replace(self.pending, again_from=now)

    def not_observed(self, result: Result) -> frozenset[str]:
        """What failed before PHM was restarted, if this is an OK that does not cover it."""
        if not self.restored_subjects or result.level is not Level.OK:
            return frozenset()
        covered, missing = result.evidence.subjects, self.restored_subjects.intersection(result.evidence.unobserved_of)
        return missing if covered is None else missing | self.restored_subjects.difference(covered)

    def update_condition(self, result: Result) -> None:
        """The problem has changed: update the fault that is open or was given up."""
        self.conditions.add(result.condition)
        if self.restored_subjects:  # the next PHM must know of these, too
            subjects = tuple(sorted(self.restored_subjects.union(result.evidence.subjects or ())))
            result = result.with_evidence(replace(result.evidence, subjects=subjects))
        if self.fault is not None:
            self.fault = replace(self.fault, result=result)
        elif self.given_up is not None:
            self.given_up = replace(self.given_up, result=result)

    def clear_given_up(self) -> None:
        """It is OK, or there is a reason to try again."""
        self.escalated, self.given_up = False, None
        self.conditions.clear()

    def record_start(self, now: float, *, by_phm: bool) -> None:
        """Its container has been started: OK times from before no longer count.

        Nor for an open fault, unless PHM itself has restarted the container to restore what was OK before: that is remembered.
        """
        self.ok_in_run_before_s = max(self.ok_in_run_before_s, self.ok_since_start_s(now)) if by_phm else 0.0
        self.container_started, self.ok_before_s, self.longest_ok_s = now, 0.0, 0.0
        if self.fault is not None and not by_phm:
            self.fault = replace(self.fault, ok_since_start_s=0.0, ok_in_run_before_s=0.0, start_seen=True)

    def note_ok_end(self, now: float) -> None:
        """It is no longer published as OK. A period that began before the start of its container counts from there on."""
        period_s = now - max(self.published.since.mono, self.container_started)
        self.longest_ok_s = max(self.longest_ok_s, period_s)

    def ok_since_start_s(self, now: float) -> float:
        """Total time published as OK since its container was started."""
        spell_s = (
            now - max(self.published.since.mono, self.container_started) if self.published.level is Level.OK else 0.0
        )
        return self.ok_before_s + spell_s

    @property
    def published_given_up(self) -> bool:
        """Published as ERROR without a fault because recovery gave up: grace after a restart of PHM does not hide it."""
        return self.escalated and self.published.level is Level.ERROR

    @property
    def new_condition(self) -> bool:
        """It was given up and is now in ERROR for another reason, which must be confirmed like any ERROR."""
        return (
            self.escalated and self.failing and self.latest is not None and self.latest.condition not in self.conditions
        )

    @property
    def failing(self) -> bool:
        """Its latest result is ERROR, published or not: enough to be the cause of other problems."""
        return self.latest is not None and self.latest.level is Level.ERROR

    @property
    def unpublished(self) -> bool:
        """It is bad and not published as such, or OK while its fault is open: time may change that."""
        if self.latest is None:
            return False
        if self.latest.level is Level.OK:
            return self.fault is not None or self.published_given_up
        return self.latest.level.bad and (self.published.level is not self.latest.level or self.new_condition)

    @property
    def settled(self) -> bool:
        """Its latest result is OK and nothing is open: time changes nothing."""
        healthy = self.latest is not None and self.latest.level is Level.OK
        return healthy and self.pending is None and self.fault is None and not self.escalated

    @property
    def waiting(self) -> bool:
        """Whether time alone can change what is published, or when its check runs again."""
        return self.pending is not None or self.unpublished

    @property
    def unknown(self) -> bool:
        return self.latest is None or self.latest.level is Level.STALE


@dataclass(frozen=True)
class TrackerView:
    """Read-only state for the rules. By target: actions in progress, the end of its stop timeout (monotonic seconds), holds."""

    units: Mapping[str, UnitRecord]
    needs: DependencyGraph
    actions: Mapping[str, ActionInProgress]
    stops: Mapping[str, float] = field(default_factory=dict)
    holds: Mapping[str, TargetHold] = field(default_factory=dict)

    def stopping(self, target: str, now: float) -> bool:
        return now < self.stops.get(target, NEVER)

    def is_part(self, unit: str) -> bool:
        """Whether the unit depends on another one of its own target, as a node depends on its container."""
        record = self.units[unit]
        return bool(record.target) and any(other.target == record.target for other in self.upstream(unit))

    @cached_property
    def starved(self) -> Mapping[str, tuple[UnitRecord, ...]]:
        """By pressure unit: the units whose symptoms it can explain."""
        found: dict[str, list[UnitRecord]] = {}
        for record in self.units.values():
            for name in record.spec.starved_by:
                found.setdefault(name, []).append(record)
        return {name: tuple(entries) for name, entries in found.items()}

    def upstream(self, unit: str) -> list[UnitRecord]:
        """All dependencies of the unit, causes first."""
        return [self.units[name] for name in self.needs.upstream(unit)]

    def downstream(self, unit: str) -> list[UnitRecord]:
        return [self.units[name] for name in self.needs.downstream(unit)]

    def waiting_for(self, unit: str) -> list[UnitRecord]:
        """Dependents of the unit in its target without a separate fault, open or given up, and that need no other unit that has one.

        That one may be anywhere: a topic also needs the nodes of other containers, and no action on this one brings those back.
        """
        record = self.units[unit]
        apart = {
            other.id
            for other in self.units.values()
            if other is not record and (other.fault is not None or other.published_given_up)
        }
        return [
            other
            for other in self.downstream(unit)
            if other.target == record.target and apart.isdisjoint((other.id, *self.needs.upstream(other.id)))
        ]


def graph_of(tracked: Iterable[TrackedUnit]) -> DependencyGraph:
    """The dependency graph of these units. Raises `phm.core.dependency_graph.DependencyCycle`."""
    return DependencyGraph({record.unit.id: record.needs for record in tracked})


def all_needs(unit: Unit, added: Iterable[str], units_by_check: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """A unit's own dependencies and those from the configuration, where the name of a check means all its units."""
    wanted = list(unit.needs)
    for name in added:
        wanted.extend(units_by_check.get(name, (name,)))
    return tuple(dict.fromkeys(need for need in wanted if need != unit.id))
