"""From results to transitions and faults: thresholds, warm-up, root cause. Pure; the caller brings time.

The rules, in the order in which `_judge` applies them to a unit's newest result:

1. OK is told at once; the unit's fault closes. Whoever was blocked by it is looked at afresh, with grace.
2. STALE is told at once and closes nothing: not knowing is no cure.
3. A bad result while an action is at work on the unit's target follows from that action: the unit is
   STALE `blocked_by` the fault under repair. A unit whose own fault is open stays as it is.
4. A bad result while something it needs is bad is a consequence: STALE `blocked_by` the first cause.
   If it had been told as a fault of its own, that fault is closed as reattributed.
5. A bad result during grace (after start, after a need recovered) is `not known yet`. Grace ends early when
   the unit has been OK for SURE_S.
   What was seen before the grace began never counts again: the unit is run anew.
6. Otherwise all its needs are run again. It is told only when it was bad `failures` times in a row, has lasted
   `settle_s`, and each need, and with `settle_s` the unit too, has answered in a run that began after that.
   Needs that are STALE get UNKNOWN_S to be known.
   While its own fault is under repair, OK is kept back: it counts when the repair is proven, dependents included, or
   after UNPROVEN_S when it is not.
7. OK after ERROR, told or not, gives grace to all that need the unit: what looked bad meanwhile may follow from it.

So one cause raises one alarm, whatever order the evidence arrives in and whichever wake-up is lost, as long as
the evidence of the cause can be seen within the dependent's `settle_s`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from phm.api import Unit
from phm.model import (
    Event,
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Outcome,
    Result,
    Slot,
    Stamp,
    Transition,
    UnitState,
)
from phm.needs import Needs

ITSELF = "itself"
CONFIGURATION = "configuration"
"""What ended a fault whose unit is no longer configured."""
RESTORED = "restored after a restart of PHM"
ASK_AGAIN_S = 1.0
"""While a bad result waits to be confirmed, it and its needs are run again this often."""
UNPROVEN_S = 30.0
"""How long a unit that is OK again stays ERROR because what needs it has not come back: time for the next action."""
UNKNOWN_S = 10.0
"""How long a bad result waits for a need that is STALE at the moment."""
SURE_S = 2.5
"""Grace ends early once a unit has been OK for this long: shorter could be the memory of what was there before (a killed
node stays listed until its lease ends, 1 s with the profile in config/fastdds.xml)."""
_NEVER = float("-inf")


@dataclass(frozen=True, slots=True)
class Tracked:
    """A unit with what its check says about it."""

    unit: Unit
    check: str
    slot: Slot
    layer: Layer
    failures: int = 1
    needs: tuple[str, ...] = ()
    """All needs: the unit's own and those that the configuration adds."""


@dataclass(slots=True)
class Step:
    """What follows from one call: events for the bus, in order, and units whose checks must run again."""

    events: list[Event] = field(default_factory=list)
    rerun: set[str] = field(default_factory=set)


@dataclass(slots=True)
class _Hold:
    """An action is at work on a target; `until` ends the hold even if its owner has died."""

    owner: str
    action: str
    until: float
    proving: bool = False
    """The owner's OK is kept back until the action is proven to have helped all that need it."""


@dataclass(slots=True)
class _Unit:
    """Everything known about one unit. `raw` is its newest result, `told` what is published."""

    spec: Tracked
    told: UnitState
    raw: Result | None = None
    started: float = _NEVER
    bad_in_a_row: int = 0
    pending_since: float | None = None
    harmed: bool = False
    """It has been ERROR, told or not, since it was last OK (rule 7)."""
    asked: bool = False
    """Its witnesses have been called for the last time before it is told (rule 6)."""
    counts_from: float = _NEVER
    """Runs that began earlier prove nothing bad any more (rule 5)."""
    quiet_until: float = 0.0
    well_since: float | None = None
    unproven_until: float = _NEVER
    """Its repair did not bring back what needs it; until then it is not believed to be well."""
    fault: Fault | None = None
    escalated: bool = False
    given_up: Fault | None = None
    """The fault that recovery gave up on, while `escalated`."""

    @property
    def id(self) -> str:
        return self.spec.unit.id

    def grant(self, now: float, until: float) -> None:
        """Grace until then; what was seen before `now` no longer counts."""
        self.pending_since = self.well_since = None
        self.bad_in_a_row, self.counts_from = 0, now
        self.quiet_until = max(self.quiet_until, until)

    @property
    def told_given_up(self) -> bool:
        """Known as a fault that PHM has given up on: grace after a restart of PHM does not make it unknown again."""
        return self.escalated and self.told.level is Level.ERROR

    @property
    def failing(self) -> bool:
        """Its newest result is an ERROR, whether told or not: enough to be somebody else's cause."""
        return self.raw is not None and self.raw.level is Level.ERROR


class Tracker:
    """See the module. Not thread-safe: the pipeline calls it under one lock.

    Invariants: a unit has at most one open fault; a fault is opened by ERROR only and closed exactly once;
    `told.level` is ERROR whenever a fault is open, except while the unit cannot be judged (STALE).
    """

    def __init__(self, tracked: Sequence[Tracked], now: Stamp, fault_prefix: str = "F") -> None:
        self.needs = Needs({entry.unit.id: entry.needs for entry in tracked})
        self._prefix = fault_prefix
        self._count = 0
        self._taken: frozenset[str] = frozenset()
        self._holds: dict[str, _Hold] = {}
        self._units: dict[str, _Unit] = {}
        for entry in tracked:
            nothing = Result(Level.STALE, "no result yet")
            told = UnitState(entry.unit.id, entry.check, entry.slot, entry.layer, Level.STALE, nothing, now)
            self._units[entry.unit.id] = _Unit(entry, told, quiet_until=now.mono + entry.unit.grace_s)

    # ------------------------------------------------------------ what is

    def states(self) -> tuple[UnitState, ...]:
        return tuple(unit.told for unit in self._units.values())

    def state(self, unit: str) -> UnitState:
        return self._units[unit].told

    def last_started(self, unit: str) -> float:
        """When the run that gave the newest result began (monotonic seconds)."""
        return self._units[unit].started

    def found_well(self, unit: str, mono: float) -> bool:
        """Whether a run that began after `mono` found the unit OK, told or kept back."""
        entry = self._units[unit]
        return entry.raw is not None and entry.raw.level is Level.OK and entry.started >= mono

    def suffering(self, unit: str, mono: float) -> tuple[str, ...]:
        """Units of the same target that need `unit` and have not been found free of ERROR in a run since `mono`.

        Those with a fault of their own are not counted: it is not this repair that they wait for.
        """
        target = self._units[unit].spec.unit.target
        below = (self._units[name] for name in self.needs.downstream(unit))
        return tuple(
            entry.id
            for entry in below
            if entry.spec.unit.target == target
            and entry.fault is None
            and not entry.told_given_up
            and (entry.failing or entry.started < mono)
        )

    def open_faults(self) -> tuple[Fault, ...]:
        return tuple(unit.fault for unit in self._units.values() if unit.fault is not None)

    def given_up(self) -> tuple[Fault, ...]:
        """The escalated faults of units that have not been well since."""
        return tuple(unit.given_up for unit in self._units.values() if unit.escalated and unit.given_up is not None)

    def undecided(self, now: Stamp) -> tuple[str, ...]:
        """Units that need more time or more results before they can be told."""
        return tuple(
            unit.id
            for unit in self._units.values()
            if unit.raw is None
            or unit.pending_since is not None
            or (self._too_early(unit, now) and unit.raw.level is not Level.OK and not unit.told.blocked_by)
        )

    # ------------------------------------------------------------ what was, before PHM was started again

    def restore(self, faults: Iterable[Fault], given_up: Iterable[Fault], now: Stamp) -> Step:
        """Put back what an earlier run of PHM left open or had given up, before the first result.

        No FaultOpened is sent: it was told once. Faults of units that the configuration no longer names are
        closed in the returned step, as resolved by ``configuration``.
        """
        step = Step()
        faults, given_up = tuple(faults), tuple(given_up)
        self._taken = frozenset(fault.id for fault in (*faults, *given_up))
        for fault in faults:
            entry = self._units.get(fault.unit)
            if entry is None:
                closed = replace(fault, closed=now, outcome=Outcome.RESOLVED, by=CONFIGURATION)
                step.events.append(FaultClosed(now, closed))
            elif entry.fault is None:
                entry.fault = replace(fault, slot=entry.spec.slot, layer=entry.spec.layer)
                self._restored(entry, fault, fault.id)
        for fault in given_up:
            entry = self._units.get(fault.unit)
            if entry is not None and entry.fault is None:
                entry.escalated, entry.given_up = True, fault
                self._restored(entry, fault, "")
        return step

    def _restored(self, entry: _Unit, fault: Fault, name: str) -> None:
        summary = f"{RESTORED}: {fault.result.summary}"
        result = replace(fault.result, level=Level.ERROR, summary=summary)
        entry.told = replace(entry.told, level=Level.ERROR, result=result, since=fault.opened, fault=name)

    # ------------------------------------------------------------ what happens

    def observe(self, unit: str, result: Result, started: float, now: Stamp, duration_s: float = 0.0) -> Step:
        """Take one result of a run that began at `started` (monotonic seconds)."""
        step = Step()
        entry = self._units[unit]
        if started < entry.started:
            return step  # an overdue run came back after a newer one: it knows less
        entry.raw, entry.started = result, started
        entry.harmed = entry.harmed or entry.failing
        entry.bad_in_a_row = entry.bad_in_a_row + 1 if result.level.bad else 0
        entry.told = replace(entry.told, duration_s=duration_s)
        self._judge(entry, now, step)
        self._judge_dependents(entry, now, step)
        return step

    def tick(self, now: Stamp) -> Step:
        """Let time pass: ends holds that outlived their action, grace and settling."""
        step = Step()
        for target in [target for target, hold in self._holds.items() if now.mono >= hold.until]:
            self._release(target, now, step)
        for entry in self._units.values():
            kept_back = entry.fault is not None and entry.raw is not None and entry.raw.level is Level.OK
            untold = entry.raw is not None and entry.raw.level.bad and entry.told.level is not entry.raw.level
            if kept_back or untold:
                self._judge(entry, now, step)
            if entry.pending_since is not None:
                waiting = (entry.id, *self.needs.upstream(entry.id))
                step.rerun.update(name for name in waiting if now.mono - self._units[name].started >= ASK_AGAIN_S)
        return step

    def hold(
        self, target: str, owner: str, action: str, now: Stamp, at_most_s: float, *, proving: bool = False
    ) -> Step:
        """An action begins on `target`, for the fault of unit `owner`. With `proving`, `release` says whether the owner
        may be believed to be well."""
        self._holds[target] = _Hold(owner, action, now.mono + at_most_s, proving)
        for entry in self._units.values():
            if entry.fault is not None and (entry.id == owner or entry.spec.unit.target == target):
                entry.fault = replace(entry.fault, by=action)
        return Step()

    def release(self, target: str, now: Stamp, *, worked: bool) -> Step:
        """The action on `target` is over; `worked` False takes back its credit for what heals later."""
        step = Step()
        hold = self._holds.get(target)
        self._release(target, now, step)
        if hold is not None and hold.proving:
            self._settle_owner(self._units[hold.owner], worked, now, step)
        if hold is not None and not worked:
            for entry in self._units.values():
                if entry.fault is not None and entry.fault.by == hold.action:
                    entry.fault = replace(entry.fault, by="")
        return step

    def _settle_owner(self, owner: _Unit, worked: bool, now: Stamp, step: Step) -> None:
        """The repair of `owner` is over: what it said meanwhile counts now, or not yet."""
        owner.unproven_until = _NEVER if worked else now.mono + UNPROVEN_S
        if worked:
            self._judge(owner, now, step)

    def expect_end(self, target: str, now: Stamp, at_most_s: float) -> Step:
        """Somebody has told the container to end: its parts go first, and are not to be told before it.

        Units of the target that need another unit of it get grace; the container's own unit does not.
        """
        for entry in self._units.values():
            above = (self._units[need].spec.unit.target for need in self.needs.upstream(entry.id))
            if entry.spec.unit.target == target and target in above:
                entry.grant(now.mono, now.mono + at_most_s)
        return Step()

    def escalate(self, fault_id: str, now: Stamp) -> Step:
        """Recovery has given up on this fault: close it as escalated. The unit stays ERROR until it is well."""
        step = Step()
        for entry in self._units.values():
            if entry.fault is not None and entry.fault.id == fault_id:
                entry.given_up, entry.escalated = entry.fault, True
                self._close(entry, Outcome.ESCALATED, "", now, step)
        return step

    # ------------------------------------------------------------ the rules

    def _judge(self, entry: _Unit, now: Stamp, step: Step) -> None:
        result = entry.raw
        if result is None:
            return
        if result.level is Level.OK:
            self._well(entry, result, now, step)
            return
        entry.well_since = None
        entry_hold = self._holds.get(entry.spec.unit.target)
        if entry_hold is not None and result.level.bad:
            entry.pending_since = None
            if entry.fault is None and entry.id != entry_hold.owner:
                self._blocked(entry, entry_hold.owner, now, step)
            return
        cause = self._cause(entry, now)
        if cause:
            entry.pending_since = None
            self._blocked(entry, cause, now, step)
        elif result.level is Level.STALE:
            entry.pending_since = None
            self._tell(entry, Level.STALE, result, now, step)
        elif self._too_early(entry, now):
            entry.pending_since = None
            waiting = replace(
                result, level=Level.STALE, summary=f"not known yet: {result.summary}", brief="", condition=""
            )
            self._tell(entry, Level.STALE, waiting, now, step)
        else:
            self._bad(entry, result, now, step)

    def _too_early(self, entry: _Unit, now: Stamp) -> bool:
        """Rule 5. An open or given-up fault goes on meanwhile."""
        known = entry.fault is not None or entry.told_given_up
        return not known and (now.mono < entry.quiet_until or entry.started < entry.counts_from)

    def _well(self, entry: _Unit, result: Result, now: Stamp, step: Step) -> None:
        if entry.fault is not None and (self._under_repair(entry) or now.mono < entry.unproven_until):
            return
        recovered = entry.harmed or entry.told.level is Level.ERROR or bool(entry.told.blocked_by)
        entry.harmed = False
        entry.pending_since, entry.escalated, entry.given_up = None, False, None
        entry.well_since = now.mono if entry.well_since is None else entry.well_since
        if now.mono - entry.well_since >= SURE_S:
            entry.quiet_until = min(entry.quiet_until, now.mono)
        self._tell(entry, Level.OK, result, now, step)
        if entry.fault is not None:
            self._close(entry, Outcome.RESOLVED, entry.fault.by or ITSELF, now, step)
        if recovered:
            self._give_grace(self.needs.downstream(entry.id), now, step)

    def _under_repair(self, entry: _Unit) -> bool:
        hold = self._holds.get(entry.spec.unit.target)
        return hold is not None and hold.proving and hold.owner == entry.id

    def _bad(self, entry: _Unit, result: Result, now: Stamp, step: Step) -> None:
        if entry.told.level is result.level and not entry.told.blocked_by:
            self._tell(entry, result.level, result, now, step)
            return
        upstream = self.needs.upstream(entry.id)
        if entry.pending_since is None:
            entry.pending_since, entry.asked = now.mono, False
            step.rerun.update(upstream)
        settled = entry.pending_since + entry.spec.unit.settle_s
        if now.mono < settled:
            return
        witnesses = (entry.id, *upstream) if settled > entry.pending_since else upstream
        silent = [name for name in witnesses if self._units[name].started < settled]
        if not entry.asked:
            entry.asked = True
            step.rerun.update(silent)
        # What it needs may be the cause and is not known at the moment: it gets time to become known, not for ever.
        unknown = any(self._unknown(need) for need in upstream) and now.mono - entry.pending_since < UNKNOWN_S
        if not silent and not unknown and entry.bad_in_a_row >= entry.spec.failures:
            entry.pending_since = None
            self._tell(entry, result.level, result, now, step)

    def _unknown(self, name: str) -> bool:
        raw = self._units[name].raw
        return raw is None or raw.level is Level.STALE

    def _cause(self, entry: _Unit, now: Stamp) -> str:
        """The first unit upstream that is failing, or whose repair did not bring back what needs it.

        If that one is under repair, the fault being repaired.
        """
        for need in self.needs.upstream(entry.id):
            other = self._units[need]
            if other.failing or (other.fault is not None and now.mono < other.unproven_until):
                hold = self._holds.get(other.spec.unit.target)
                return hold.owner if hold is not None and other.fault is None else need
        return ""

    def _judge_dependents(self, entry: _Unit, now: Stamp, step: Step) -> None:
        for name in self.needs.downstream(entry.id):
            other = self._units[name]
            if other.raw is not None and other.raw.level is not Level.OK:
                self._judge(other, now, step)

    def _blocked(self, entry: _Unit, cause: str, now: Stamp, step: Step) -> None:
        if cause == entry.id:
            return
        if entry.fault is not None:
            self._close(entry, Outcome.REATTRIBUTED, cause, now, step)
        assert entry.raw is not None
        blocked = replace(entry.raw, level=Level.STALE, summary=f"blocked by {cause}: {entry.raw.summary}")
        self._tell(entry, Level.STALE, blocked, now, step, blocked_by=cause)
        causing = self._units[cause]
        if causing.fault is not None and entry.id not in causing.fault.blocks:
            causing.fault = replace(causing.fault, blocks=(*causing.fault.blocks, entry.id))

    def _release(self, target: str, now: Stamp, step: Step) -> None:
        if self._holds.pop(target, None) is None:
            return
        touched = [unit.id for unit in self._units.values() if unit.spec.unit.target == target]
        below = {name for unit in touched for name in self.needs.downstream(unit)}
        self._give_grace([*touched, *sorted(below.difference(touched))], now, step)

    def _give_grace(self, units: Iterable[str], now: Stamp, step: Step) -> None:
        """What was seen before no longer counts: look again, and give it time to come back."""
        for name in units:
            entry = self._units[name]
            entry.grant(now.mono, now.mono + entry.spec.unit.grace_s)
            if entry.raw is not None and entry.raw.level is not Level.OK:
                step.rerun.add(name)

    # ------------------------------------------------------------ telling

    def _tell(self, entry: _Unit, level: Level, result: Result, now: Stamp, step: Step, blocked_by: str = "") -> None:
        old = entry.told
        changed = old.level is not level
        reworded = (
            not changed and level.bad and (old.result.condition, old.result.brief) != (result.condition, result.brief)
        )
        since = now if changed else old.since
        if level is Level.ERROR and entry.fault is None and not entry.escalated:
            self._open(entry, result, now)
            assert entry.fault is not None
            step.events.append(FaultOpened(now, entry.fault))
        if reworded and entry.fault is not None:
            entry.fault = replace(entry.fault, result=result)
        fault = entry.fault.id if entry.fault is not None else ""
        entry.told = replace(old, level=level, result=result, since=since, blocked_by=blocked_by, fault=fault)
        if changed or reworded:
            step.events.append(Transition(now, old.level, entry.told, changed_text=reworded))
        if changed and level is Level.ERROR:
            self._judge_dependents(entry, now, step)

    def _open(self, entry: _Unit, result: Result, now: Stamp) -> None:
        self._count += 1
        while f"{self._prefix}{self._count}" in self._taken:
            self._count += 1
        spec = entry.spec
        entry.fault = Fault(
            f"{self._prefix}{self._count}",
            entry.id,
            spec.slot,
            spec.layer,
            result,
            now,
            consequences=self._consequences(entry.id),
            suspects=self._suspects(entry.id),
        )

    def _consequences(self, unit: str) -> tuple[str, ...]:
        """Names of the checks that cannot be well while `unit` is not, in slot order."""
        below = sorted((self._units[name].spec for name in self.needs.downstream(unit)), key=lambda spec: spec.slot)
        return tuple(dict.fromkeys(spec.check for spec in below))

    def _suspects(self, unit: str) -> tuple[str, ...]:
        """Units told as ERROR that can be behind anything (`Unit.suspect`), such as a full disk."""
        return tuple(
            other.id
            for other in self._units.values()
            if other.spec.unit.suspect and other.told.level is Level.ERROR and other.id != unit
        )

    def _close(self, entry: _Unit, outcome: Outcome, by: str, now: Stamp, step: Step) -> None:
        assert entry.fault is not None
        closed = replace(entry.fault, closed=now, outcome=outcome, by=by)
        entry.fault = None
        entry.told = replace(entry.told, fault="")
        step.events.append(FaultClosed(now, closed))


def all_needs(unit: Unit, added: Iterable[str], units_by_check: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """A unit's own needs and the configuration's, where the name of a check stands for all its units."""
    wanted = list(unit.needs)
    for name in added:
        wanted.extend(units_by_check.get(name, (name,)))
    return tuple(dict.fromkeys(need for need in wanted if need != unit.id))
