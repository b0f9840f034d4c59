"""Keeps what is known about every unit, and lets follow what the rules (`phm.tracker.rules`) say about it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm.core.dependency_graph import DependencyGraph
from phm.core.model import Fault, Level, Outcome, Result, Stamp, Transition, UnitState
from phm.tracker import starvation
from phm.tracker.faults import FaultRecords
from phm.tracker.rules import GRACE_ENDS_AFTER_OK_S, as_unknown, decide, in_grace
from phm.tracker.start_dedup import StartDedup, StartSeen
from phm.tracker.units import NEVER, ActionInProgress, Effects, TargetHold, TrackedUnit, TrackerView, UnitRecord

ITSELF = "itself"
ASK_AGAIN_S = 1.0
"""While a bad result waits to be confirmed, it and its needs are run again this often."""
LOOK_AGAIN_S = 0.15
"""A unit that settles, even this often: evidence may end the waiting early (`Result.settle_s`)."""
UNPROVEN_S = 30.0
"""How long a unit that is OK again stays ERROR because what needs it has not come back: time for the next action."""
PRESSURE = "pressure/"
"""Units that say whether a container is starved: this and its key."""


class Tracker:
    """See the package. Not thread-safe: the pipeline calls it under one lock.

    Invariants: a unit has at most one open fault; a fault is opened by ERROR only and closed exactly once;
    `told.level` is ERROR whenever a fault is open, except while the unit cannot be judged (STALE).
    """

    def __init__(self, tracked: Sequence[TrackedUnit], now: Stamp, fault_prefix: str = "F") -> None:
        self.needs = DependencyGraph({entry.unit.id: entry.needs for entry in tracked})
        self._holds: dict[str, ActionInProgress] = {}
        self._units: dict[str, UnitRecord] = {}
        self._stops: dict[str, float] = {}
        self._pauses: dict[str, TargetHold] = {}
        self._scene = TrackerView(self._units, self.needs, self._holds, self._stops, self._pauses)
        self._lives = StartDedup()
        self._episodes = FaultRecords(self._scene, fault_prefix, self._lives)
        for entry in tracked:
            nothing = Result(Level.STALE, "no result yet")
            told = UnitState(entry.unit.id, entry.check, entry.slot, entry.layer, Level.STALE, nothing, now)
            self._units[entry.unit.id] = UnitRecord(entry, told, grace_until=now.mono + entry.unit.grace_s)

    # ------------------------------------------------------------ what is

    def states(self) -> tuple[UnitState, ...]:
        return tuple(entry.told for entry in self._units.values())

    def state(self, unit: str) -> UnitState:
        return self._units[unit].told

    def last_started(self, unit: str) -> float:
        """When the run that gave the newest result began (monotonic seconds)."""
        return self._units[unit].started

    def found_ok(self, unit: str, mono: float) -> bool:
        """Whether a run that began after `mono` found the unit OK, told or kept back."""
        entry = self._units[unit]
        return entry.raw is not None and entry.raw.level is Level.OK and entry.started >= mono

    def newest(self, unit: str, mono: float) -> Result | None:
        """The newest result, published or not, if its run began after `mono`."""
        entry = self._units[unit]
        return entry.raw if entry.started >= mono else None

    def confirmed_bad(self, unit: str, mono: float) -> bool:
        """Whether the unit is ERROR and a run that began after `mono` has confirmed that: a run of its own check, or, while
        its OK is kept back, one that found something in ERROR which needs it. What it found must be what is published."""
        entry = self._units[unit]
        if entry.told.level is not Level.ERROR or entry.started < mono:
            return False
        if entry.raw is None or entry.raw.level is not Level.OK:
            return entry.failing and entry.raw is not None and entry.raw.condition == entry.told.result.condition
        return any(self._units[name].failing and self._units[name].started >= mono for name in self._below(entry))

    def _below(self, entry: UnitRecord) -> list[str]:
        """Units of the same target that need this one and have no fault of their own. Not its pressure: a repair cannot end that."""
        return [
            other.id
            for other in self._scene.downstream(entry.id)
            if other.target == entry.target and other.fault is None and not other.published_given_up
            if not other.id.startswith(PRESSURE)
        ]

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        """Units of the same target that need `unit` and have not been found free of ERROR in a run since `mono`.

        Those with a fault of their own are not counted: it is not this repair that they wait for.
        """
        below = (self._units[name] for name in self._below(self._units[unit]))
        return tuple(entry.id for entry in below if entry.failing or entry.started < mono)

    def starved_by(self, unit: str, now: Stamp) -> str:
        """The pressure unit that explains what is wrong with this one, now or until a moment ago; empty: none does.

        Recovery leaves a fault alone meanwhile that was open before: a restart needs what there is too little of.
        """
        entry = self._units[unit]
        starver = starvation.cause(entry, self._scene)
        if starver is not None:
            return starver.id
        return entry.starver if starvation.recovering(entry, now.mono) else ""

    def active_pressure(self, unit: str) -> str:
        """The pressure unit that is published in ERROR and starves the unit now, whatever it explains; empty: none."""
        found = (self._units[name] for name in self._units[unit].spec.starved_by)
        return next((other.id for other in found if other.starving is not None and other.told.level is Level.ERROR), "")

    def open_faults(self) -> tuple[Fault, ...]:
        return tuple(entry.fault for entry in self._units.values() if entry.fault is not None)

    def given_up(self) -> tuple[Fault, ...]:
        """The escalated faults of units that have not been well since."""
        return tuple(entry.given_up for entry in self._units.values() if entry.escalated and entry.given_up is not None)

    def undecided(self, now: Stamp) -> tuple[str, ...]:
        """Units that need more time or more results before they can be told."""
        return tuple(
            entry.id
            for entry in self._units.values()
            if entry.raw is None
            or entry.pending is not None
            or (in_grace(entry, now.mono) and entry.raw.level is not Level.OK and not entry.told.blocked_by)
        )

    # ------------------------------------------------------------ what was, before PHM was started again

    def restore(self, faults: Iterable[Fault], given_up: Iterable[Fault], now: Stamp) -> Effects:
        """Put back what an earlier run of PHM left open or had given up, before the first result.

        No FaultOpened is sent: it was told once. Faults of units that the configuration no longer names are
        closed in the returned step, as resolved by ``configuration``.
        """
        return self._episodes.restore(tuple(faults), tuple(given_up), now)

    # ------------------------------------------------------------ what happens

    def observe(self, unit: str, result: Result, started: float, now: Stamp, duration_s: float = 0.0) -> Effects:
        """Take one result of a run that began at `started` (monotonic seconds)."""
        step = Effects()
        entry = self._units[unit]
        if started < entry.started:
            return step  # an overdue run came back after a newer one: it knows less
        entry.raw, entry.started = result, started
        entry.had_error = entry.had_error or entry.failing
        entry.bad_in_a_row = entry.bad_in_a_row + 1 if result.level.bad else 0
        entry.told = replace(entry.told, duration_s=duration_s)
        if entry.target and result.evidence.generation:
            self._see_life(entry.target, unit, result.evidence.generation, started, now, step)
        self._judge(entry, now, step)
        self._judge_dependents(entry, now, step)
        if unit in self._scene.starved:
            self._note_starvation(entry, now, step)
        step.waiting = entry.waiting or any(other.waiting for other in self._scene.downstream(entry.id))
        return step

    def tick(self, now: Stamp) -> Effects:
        """Let time pass: ends holds that outlived their action, grace and settling."""
        step = Effects()
        for target in [target for target, hold in self._holds.items() if now.mono >= hold.until]:
            self._release(target, now, step)
        step.waiting = bool(self._holds)
        for name in self._scene.starved:
            if self._units[name].starving is not None and self._units[name].unknown:
                self._note_starvation(self._units[name], now, step)
        for entry in self._units.values():
            if entry.unpublished:
                self._judge(entry, now, step)
            step.waiting |= entry.waiting
            if starvation.recovering(entry, now.mono) and now.mono - entry.started >= ASK_AGAIN_S:
                step.rerun.add(entry.id)
            if entry.pending is not None:
                waiting = (entry, *self._scene.upstream(entry.id), *starvation.pressure_units(entry, self._scene))
                step.rerun.update(other.id for other in waiting if now.mono - other.started >= ASK_AGAIN_S)
                if entry.spec.unit.settle_s > 0 and now.mono - entry.started >= LOOK_AGAIN_S:
                    step.rerun.add(entry.id)
        return step

    # ------------------------------------------------------------ what recovery and the world do

    def begin_action(
        self, target: str, owner: str, action: str, now: Stamp, at_most_s: float, *, proving: bool = False
    ) -> Effects:
        """An action begins on `target`, for the fault of unit `owner`. With `proving`, `release` says whether the owner
        may be believed to be well."""
        self._holds[target] = ActionInProgress(owner, action, now.mono + at_most_s, proving)
        for entry in self._units.values():
            if entry.fault is not None and (entry.id == owner or entry.target == target):
                entry.fault = replace(entry.fault, by=action)
        return Effects()

    def end_action(self, target: str, now: Stamp, *, worked: bool) -> Effects:
        """The action on `target` is over; `worked` False takes back its credit for what heals later."""
        step = Effects()
        hold = self._holds.get(target)
        self._release(target, now, step)
        if hold is None:
            return step
        if hold.proving:
            # What the owner said meanwhile counts now, or not yet.
            owner = self._units[hold.owner]
            owner.unverified_from, owner.unverified_until = now.mono, NEVER if worked else now.mono + UNPROVEN_S
            if worked:
                self._judge(owner, now, step)
        if not worked:
            for entry in self._units.values():
                if entry.fault is not None and entry.fault.by == hold.action:
                    entry.fault = replace(entry.fault, by="")
        return step

    def clear_action_credit(self, unit: str) -> Effects:
        """The action for the unit's fault has not helped: what heals later is not its doing."""
        entry = self._units[unit]
        if entry.fault is not None:
            entry.fault = replace(entry.fault, by="")
        return Effects()

    def action_on(self, target: str) -> str:
        """The action of recovery that is at work on the target; empty: none."""
        hold = self._holds.get(target)
        return hold.action if hold is not None else ""

    def put_on_hold(self, target: str, words: str, conditions: frozenset[str], now: Stamp) -> Effects:
        """The target is on hold until `resume`: see `TargetHold`. A new pause takes the place of an old one."""
        step = Effects()
        self._pauses[target] = TargetHold(words, conditions)
        for entry in self._units.values():
            if entry.target == target:
                self._judge(entry, now, step)
        return step

    def end_hold(self, target: str, now: Stamp) -> Effects:
        """The hold is over: what is still bad is a fault as soon as a fresh run says so, after its grace."""
        step = Effects()
        if self._pauses.pop(target, None) is not None:
            self._fresh_start(target, now, step)
        return step

    def expect_stop(self, target: str, now: Stamp, at_most_s: float) -> Effects:
        """The container has got a signal to end, and has so long to do it: its parts go first, and are no faults of their own.

        These are units of the target that need another unit of it; the container's own unit is judged as ever.
        """
        self._stops[target] = now.mono + at_most_s
        for entry in self._units.values():
            if entry.target == target and self._scene.is_part(entry.id):
                entry.grant(
                    now.mono, now.mono
                )  # what looked bad a moment before may have been the beginning of the end
        return Effects()

    def container_ended(self, target: str, now: Stamp) -> Effects:
        """The container has ended, an event says: what was seen of its parts until now may follow from that, and what was seen
        of the container itself is over. Both are run again before anything is published about a part; no grace is given.
        """
        step = Effects()
        self._stops.pop(target, None)
        self._outdate(target, now, step)
        return step

    def is_stopping(self, target: str, now: float) -> bool:
        return self._scene.stopping(target, now)

    def container_started(self, target: str, now: Stamp) -> Effects:
        """The container has been started, says an event: what needs it starts fresh, with grace, once for each life."""
        step = Effects()
        self._stops.pop(target, None)
        if self._lives.heard(target, now.mono):
            self._begin_anew(target, now, step)
        return step

    def escalate(self, fault_id: str, now: Stamp) -> Effects:
        """Recovery has given up on this fault: close it as escalated. The unit stays ERROR until it is well."""
        step = Effects()
        for entry in self._units.values():
            if entry.fault is not None and entry.fault.id == fault_id:
                entry.given_up, entry.escalated = entry.fault, True
                self._episodes.close(entry, Outcome.ESCALATED, "", now, step)
        return step

    def clear_given_up(self, units: Iterable[str], now: Stamp) -> Effects:
        """What recovery had given up on may be a fault again, after its grace: there is a reason to try anew."""
        step = Effects()
        given_up = [self._units[name] for name in units if name in self._units and self._units[name].escalated]
        for entry in given_up:
            entry.clear_given_up()
        self._give_grace([entry.id for entry in given_up], now, step)
        for entry in given_up:
            if entry.told.level is Level.ERROR:  # without a fault until it is known again
                self._tell(entry, as_unknown(entry.told.result), now, step)
        return step

    # ------------------------------------------------------------ what follows

    def _judge(self, entry: UnitRecord, now: Stamp, step: Effects) -> None:
        verdict = decide(entry, self._scene, now.mono)
        if verdict is None or entry.raw is None:
            return
        entry.pending = verdict.pending
        step.rerun |= verdict.ask
        if entry.raw.level is not Level.OK:
            entry.ok_since = None
        if verdict.tell is None:
            return
        if verdict.blocked_by:
            self._blame(entry, verdict.tell, verdict.blocked_by, now, step)
        elif verdict.tell.level is Level.OK:
            self._came_well(entry, verdict.tell, now, step)
        else:
            self._tell(entry, verdict.tell, now, step)

    def _judge_dependents(self, entry: UnitRecord, now: Stamp, step: Effects) -> None:
        for other in self._scene.downstream(entry.id):
            if other.raw is not None and other.raw.level is not Level.OK:
                self._judge(other, now, step)

    def _note_starvation(self, entry: UnitRecord, now: Stamp, step: Effects) -> None:
        """A pressure unit has been looked at: symptoms that wait for that are judged, and all when it began or ended."""
        changed = starvation.observe(entry, now.mono)
        for other in self._scene.starved[entry.id]:
            if changed and entry.starving is None:
                starvation.ended(other, entry.id, now.mono)
            if other.raw is None or not other.raw.level.bad:
                continue
            if changed and entry.starving is None:
                step.rerun.add(other.id)
            if changed or other.pending is not None:
                self._judge(other, now, step)

    def _came_well(self, entry: UnitRecord, result: Result, now: Stamp, step: Effects) -> None:
        recovered = entry.had_error or entry.told.level is Level.ERROR or bool(entry.told.blocked_by)
        entry.had_error = False
        entry.clear_given_up()
        entry.ok_since = now.mono if entry.ok_since is None else entry.ok_since
        if now.mono - entry.ok_since >= max(GRACE_ENDS_AFTER_OK_S, entry.spec.unit.memory_s):
            entry.grace_until = min(entry.grace_until, now.mono)
            entry.symptom_grace_until = min(entry.symptom_grace_until, now.mono)
        self._tell(entry, result, now, step)
        if entry.fault is not None:
            self._episodes.close(entry, Outcome.RESOLVED, entry.fault.by or ITSELF, now, step)
        if recovered:
            # What looked bad below it meanwhile, told or not, may follow from it.
            self._give_grace(self.needs.downstream(entry.id), now, step)

    def _blame(self, entry: UnitRecord, result: Result, cause: str, now: Stamp, step: Effects) -> None:
        self._episodes.close(entry, Outcome.REATTRIBUTED, cause, now, step)
        self._tell(entry, result, now, step, blocked_by=cause)
        causing = self._units[cause]
        if causing.fault is not None and entry.id not in causing.fault.blocks:
            causing.fault = replace(causing.fault, blocks=(*causing.fault.blocks, entry.id))

    def _release(self, target: str, now: Stamp, step: Effects) -> None:
        if self._holds.pop(target, None) is not None:
            self._fresh_start(target, now, step)

    def _fresh_start(self, target: str, now: Stamp, step: Effects) -> None:
        """What was seen of the target, and of all that need it, no longer counts."""
        touched = [entry.id for entry in self._units.values() if entry.target == target]
        below = {name for unit in touched for name in self.needs.downstream(unit)}
        self._give_grace([*touched, *sorted(below.difference(touched))], now, step)

    def _see_life(self, target: str, unit: str, life: str, started: float, now: Stamp, step: Effects) -> None:
        """A run has seen the container in this life; results from before a life that is new to it prove nothing."""
        saw = self._lives.saw(target, unit, life, started)
        if saw is StartSeen.NEWS:
            self._begin_anew(target, now, step)
        elif saw is StartSeen.ANNOUNCED:
            self._outdate(target, now, step)

    def _outdate(self, target: str, now: Stamp, step: Effects) -> None:
        """What was seen until now of all that need the target proves nothing bad any more."""
        for name in self._needing(target):
            entry = self._units[name]
            entry.grant(now.mono, now.mono)
            if entry.raw is not None and entry.raw.level is not Level.OK:
                step.rerun.add(name)

    def _needing(self, target: str) -> Iterable[str]:
        """All units that need one of the target's."""
        own = [entry.id for entry in self._units.values() if entry.target == target]
        return dict.fromkeys(name for unit in own for name in self.needs.downstream(unit))

    def _begin_anew(self, target: str, now: Stamp, step: Effects) -> None:
        self._stops.pop(target, None)
        for entry in self._units.values():
            if entry.target == target:
                entry.record_start(now.mono)
        self._give_grace(self._needing(target), now, step)

    def _give_grace(self, units: Iterable[str], now: Stamp, step: Effects) -> None:
        """What was seen before no longer counts: look again, and give it time to come back."""
        for name in units:
            entry = self._units[name]
            entry.grant(now.mono, now.mono + entry.spec.unit.grace_s)
            if entry.raw is not None and entry.raw.level is not Level.OK:
                step.rerun.add(name)

    def _tell(self, entry: UnitRecord, result: Result, now: Stamp, step: Effects, blocked_by: str = "") -> None:
        old, level = entry.told, result.level
        changed = old.level is not level
        reworded = (
            not changed and level.bad and (old.result.condition, old.result.brief) != (result.condition, result.brief)
        )
        since = now if changed else old.since
        if level is Level.ERROR:
            self._episodes.open(entry, result, now, step)
        if reworded:
            entry.update_condition(result)
        if changed:
            entry.ok_before_s = entry.ok_since_start_s(now.mono)
        fault = entry.fault.id if entry.fault is not None else ""
        entry.told = replace(old, level=level, result=result, since=since, blocked_by=blocked_by, fault=fault)
        if changed or reworded:
            step.events.append(Transition(now, old.level, entry.told, changed_text=reworded))
        if changed and level is Level.ERROR:
            self._judge_dependents(entry, now, step)
