"""What is kept about each unit, and what one call to the tracker yields."""

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
    """A unit with what its check says about it."""

    unit: Unit
    check: str
    slot: Slot
    layer: Layer
    failures: int = 1
    needs: tuple[str, ...] = ()
    """All needs: the unit's own and those that the configuration adds."""
    starved_by: tuple[str, ...] = ()
    """Pressure units that can explain its symptoms: its container's, those of the containers that it needs, the host's."""


@dataclass(slots=True)
class Effects:
    """What follows from one call: events for the bus, in order, and units whose checks must run again."""

    events: list[Event] = field(default_factory=list)
    rerun: set[str] = field(default_factory=set)
    waiting: bool = True
    """Whether time alone may change something: from `observe` about the unit and what needs it, from `tick` about all."""


@dataclass(slots=True)
class ActionInProgress:
    """An action is at work on a target; `until` ends the hold even if its owner has died."""

    owner: str
    action: str
    until: float
    proving: bool = False
    """The owner's OK is kept back until the action is proven to have helped all that need it."""


@dataclass(frozen=True, slots=True)
class TargetHold:
    """A target is on hold: what is bad there is STALE with these words, and opens no fault.

    conditions: only these are, and only where no fault is open: an end that may be part of a restart. Empty: all are.
    """

    words: str
    conditions: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Pending:
    """A bad result that waits to be told, since a moment (monotonic seconds)."""

    since: float
    requested: bool = False
    """Its witnesses have been called for the last time before it is told."""


@dataclass(frozen=True, slots=True)
class Starvation:
    """A pressure unit finds that tasks stand still: since when, as of when (monotonic seconds), and in which way."""

    since: float
    seen: float
    condition: str


@dataclass(slots=True)
class UnitRecord:
    """Everything known about one unit. `raw` is its newest result, `told` what is published."""

    spec: TrackedUnit
    published: UnitState
    latest: Result | None = None
    started: float = NEVER
    bad_in_a_row: int = 0
    pending: Pending | None = None
    had_error: bool = False
    """It has been ERROR, told or not, since it was last OK: what needs it may have suffered."""
    valid_from: float = NEVER
    """Runs that began earlier prove nothing bad any more."""
    grace_until: float = 0.0
    """Grace: until then a bad result is `not known yet`."""
    ok_since: float | None = None
    container_started: float = NEVER
    """When the container of its target was last seen to be started; nothing is known before."""
    ok_before_s: float = 0.0
    """Told as OK for so long in this life of it, but for the present spell."""
    unverified_from: float = NEVER
    unverified_until: float = NEVER
    """Its repair did not bring back what needs it; until then it is not believed to be well."""
    fault: Fault | None = None
    escalated: bool = False
    given_up: Fault | None = None
    """The fault that recovery gave up on, while `escalated`."""
    starving: Starvation | None = None
    """Of a pressure unit: it explains the symptoms of those that it starves."""
    pressure_unit: str = ""
    """The pressure unit that starved it last."""
    symptoms_count_from: float = NEVER
    """When starvation last ended: symptoms of which the evidence is older prove nothing."""
    symptom_grace_until: float = NEVER
    """Until then symptoms may still follow from it."""
    conditions: set[str] = field(default_factory=set)
    """Those that its faults have had since it was last OK: giving up on one of them must not hide another."""

    @property
    def id(self) -> str:
        return self.spec.unit.id

    @property
    def target(self) -> str:
        return self.spec.unit.target

    def grant(self, now: float, until: float) -> None:
        """Grace until then; what was seen before `now` no longer counts."""
        self.pending = self.ok_since = None
        self.bad_in_a_row, self.valid_from = 0, now
        self.grace_until = max(self.grace_until, until)

    def update_condition(self, result: Result) -> None:
        """What is wrong has changed: the fault that is open, or was given up, now says so."""
        self.conditions.add(result.condition)
        if self.fault is not None:
            self.fault = replace(self.fault, result=result)
        elif self.given_up is not None:
            self.given_up = replace(self.given_up, result=result)

    def clear_given_up(self) -> None:
        """It is OK, or there is a reason to try again: nothing is given up any more."""
        self.escalated, self.given_up = False, None
        self.conditions.clear()

    def record_start(self, now: float) -> None:
        """Its container has been started: what was well before says nothing about this life."""
        self.container_started, self.ok_before_s = now, 0.0

    def ok_since_start_s(self, now: float) -> float:
        """Told as OK for so long, in all, in this life of its container."""
        spell_s = (
            now - max(self.published.since.mono, self.container_started) if self.published.level is Level.OK else 0.0
        )
        return self.ok_before_s + spell_s

    @property
    def published_given_up(self) -> bool:
        """Known as a fault that PHM has given up on: grace after a restart of PHM does not make it unknown again."""
        return self.escalated and self.published.level is Level.ERROR

    @property
    def new_condition(self) -> bool:
        """It was given up, and is now in ERROR for another reason: that is confirmed like any other ERROR."""
        return (
            self.escalated and self.failing and self.latest is not None and self.latest.condition not in self.conditions
        )

    @property
    def failing(self) -> bool:
        """Its newest result is an ERROR, whether told or not: enough to be somebody else's cause."""
        return self.latest is not None and self.latest.level is Level.ERROR

    @property
    def unpublished(self) -> bool:
        """It is bad and not told so yet, or well while its fault is still open: time may end that."""
        if self.latest is None:
            return False
        if self.latest.level is Level.OK:
            return self.fault is not None or self.published_given_up
        return self.latest.level.bad and (self.published.level is not self.latest.level or self.new_condition)

    @property
    def waiting(self) -> bool:
        """Whether time alone may change what is told, or how soon it is looked at again."""
        return self.pending is not None or self.unpublished

    @property
    def unknown(self) -> bool:
        return self.latest is None or self.latest.level is Level.STALE


@dataclass(frozen=True)
class TrackerView:
    """All units, who needs whom, by target the actions at work, until when it is given time to end (monotonic seconds), and
    the pauses. The tracker fills it, the rules only look."""

    units: Mapping[str, UnitRecord]
    needs: DependencyGraph
    actions: Mapping[str, ActionInProgress]
    stops: Mapping[str, float] = field(default_factory=dict)
    holds: Mapping[str, TargetHold] = field(default_factory=dict)

    def stopping(self, target: str, now: float) -> bool:
        return now < self.stops.get(target, NEVER)

    def is_part(self, unit: str) -> bool:
        """Whether the unit needs another one of its own target, as a node needs its container."""
        record = self.units[unit]
        return bool(record.target) and any(other.target == record.target for other in self.upstream(unit))

    @cached_property
    def starved(self) -> Mapping[str, tuple[UnitRecord, ...]]:
        """By pressure unit, those whose symptoms it can explain."""
        found: dict[str, list[UnitRecord]] = {}
        for record in self.units.values():
            for name in record.spec.starved_by:
                found.setdefault(name, []).append(record)
        return {name: tuple(entries) for name, entries in found.items()}

    def upstream(self, unit: str) -> list[UnitRecord]:
        """What the unit depends on, causes first."""
        return [self.units[name] for name in self.needs.upstream(unit)]

    def downstream(self, unit: str) -> list[UnitRecord]:
        return [self.units[name] for name in self.needs.downstream(unit)]


def graph_of(tracked: Iterable[TrackedUnit]) -> DependencyGraph:
    """The dependency graph of these units. Raises `phm.core.dependency_graph.DependencyCycle`."""
    return DependencyGraph({record.unit.id: record.needs for record in tracked})


def all_needs(unit: Unit, added: Iterable[str], units_by_check: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """A unit's own needs and the configuration's, where the name of a check stands for all its units."""
    wanted = list(unit.needs)
    for name in added:
        wanted.extend(units_by_check.get(name, (name,)))
    return tuple(dict.fromkeys(need for need in wanted if need != unit.id))
