"""Keep the state of every unit and apply the decisions of the rules (`phm.tracker.rules`)."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm.core.dependency_graph import DependencyGraph
from phm.core.model import Fault, Level, Outcome, Result, Stamp, Transition, UnitState
from phm.tracker import starvation
from phm.tracker.faults import ITSELF, TIMEOUT, FaultRecords, as_unobserved
from phm.tracker.rules import GRACE_ENDS_AFTER_OK_S, as_unknown, certain_before, decide, in_grace
from phm.tracker.start_dedup import StartDedup, StartSeen
from phm.tracker.units import NEVER, ActionInProgress, Effects, TargetHold, TrackedUnit, TrackerView, UnitRecord

logger = logging.getLogger(__name__)

ASK_AGAIN_S = 1.0
"""While a bad result waits for confirmation, its check and those of its dependencies run again this often."""
SETTLING_RERUN_S = 0.15
"""A unit with `settle_s` runs again this often: new evidence may end the wait early (`Result.settle_s`)."""
UNVERIFIED_S = 30.0
"""How long a unit that is OK again stays ERROR because its dependents have not come back: time for the next action."""
JOINS = "join_network"
"""The action that connects PHM itself to a network: it ends no other fault of the container."""
PRESSURE = "pressure/"
"""Prefix of the units that report the resource pressure of a container."""


class Tracker:
    """See the package. Not thread-safe: the pipeline calls it under one lock.

    Invariants: a unit has at most one open fault; a fault is opened by ERROR only and closed exactly once;
    the published level is ERROR whenever a fault is open, except while the unit is STALE.
    """

    def __init__(
        self, tracked: Sequence[TrackedUnit], graph: DependencyGraph, now: Stamp, fault_prefix: str = "F"
    ) -> None:
        self.graph = graph
        self._actions: dict[str, ActionInProgress] = {}
        self._units: dict[str, UnitRecord] = {}
        self._stops: dict[str, float] = {}
        self._holds: dict[str, TargetHold] = {}
        self._view = TrackerView(self._units, self.graph, self._actions, self._stops, self._holds)
        self._starts = StartDedup()
        self._faults = FaultRecords(self._view, fault_prefix, self._starts)
        for record in tracked:
            nothing = Result(Level.STALE, "no result yet")
            published = UnitState(record.unit.id, record.check, record.slot, record.layer, Level.STALE, nothing, now)
            self._units[record.unit.id] = UnitRecord(record, published, grace_until=now.mono + record.unit.grace_s)

    # ------------------------------------------------------------ queries

    def states(self) -> tuple[UnitState, ...]:
        return tuple(record.published for record in self._units.values())

    def state(self, unit: str) -> UnitState:
        return self._units[unit].published

    def last_started(self, unit: str) -> float:
        """When the run that gave the newest result began (monotonic seconds)."""
        return self._units[unit].started

    def found_ok(self, unit: str, mono: float) -> bool:
        """Whether a run that began after `mono` found the unit OK, or its failure ended, published or not."""
        record = self._units[unit]
        return record.latest is not None and record.latest.ends_fault and record.started >= mono

    def newest(self, unit: str, mono: float) -> Result | None:
        """The newest result, published or not, if its run began after `mono`; None, too, if there is no such unit."""
        record = self._units.get(unit)
        return record.latest if record is not None and record.started >= mono else None

    def confirmed_bad(self, unit: str, mono: float) -> bool:
        """Whether the unit is ERROR and a run that began after `mono` confirmed it: a run of its own check with the published
        condition and target, or, while its OK is held back, one that found a dependent in ERROR."""
        record = self._units[unit]
        if record.published.level is not Level.ERROR or record.started < mono:
            return False
        if record.latest is None or not record.latest.ends_fault:
            return (
                record.failing
                and record.latest is not None
                and (record.latest.condition, record.latest.target)
                == (record.published.result.condition, record.published.result.target)
            )
        return any(self._units[name].failing and self._units[name].started >= mono for name in self._below(record))

    def _below(self, record: UnitRecord) -> list[str]:
        """See `TrackerView.waiting_for`. Without its pressure unit: a recovery cannot end that."""
        return [other.id for other in self._view.waiting_for(record.id) if not other.id.startswith(PRESSURE)]

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        """Dependents of `unit` in the same target that no run since `mono` has found free of ERROR.

        Those with a separate fault, and what needs them, are not counted: they do not wait for this recovery.
        """
        below = (self._units[name] for name in self._below(self._units[unit]))
        return tuple(record.id for record in below if record.failing or record.started < mono)

    def unknown_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        """Dependents of `unit` in the same target that were OK since its container started, and whose newest run since `mono`
        found them unknown.

        Example: PHM was taken off the network, too, and its ROS child has just been restarted. That does not show that the nodes
        are back.
        """
        below = (self._units[name] for name in self._below(self._units[unit]))
        return tuple(
            record.id
            for record in below
            if record.started >= mono and record.unknown and record.ok_since_start_s(mono) > 0
        )

    def dependencies(self, unit: str) -> tuple[str, ...]:
        """Dependencies of `unit` in the same target, causes first, without those that are published as a separate fault."""
        record = self._units[unit]
        above = (other for other in self._view.upstream(unit) if record.target and other.target == record.target)
        return tuple(other.id for other in above if other.fault is None and not other.published_given_up)

    def starved_by(self, unit: str, now: Stamp) -> str:
        """The pressure unit that explains this unit's problem, now or until a moment ago; empty: none.

        Recovery postpones faults that were open before: a restart needs the resources that are short.
        """
        record = self._units[unit]
        pressure_unit = starvation.cause(record, self._view)
        if pressure_unit is not None:
            return pressure_unit.id
        return record.pressure_unit if starvation.recovering(record, now.mono) else ""

    def active_pressure(self, unit: str) -> str:
        """A pressure unit of this unit that is published as ERROR now, whatever it explains; empty: none."""
        found = (self._units[name] for name in self._units[unit].spec.starved_by)
        return next(
            (other.id for other in found if other.starving is not None and other.published.level is Level.ERROR), ""
        )

    def open_faults(self) -> tuple[Fault, ...]:
        """The faults that are open now, without those that were given up."""
        return tuple(record.fault for record in self._units.values() if record.fault is not None)

    def given_up(self) -> tuple[Fault, ...]:
        """Escalated faults of units that have not been OK since."""
        return tuple(
            record.given_up for record in self._units.values() if record.escalated and record.given_up is not None
        )

    def undecided(self, now: Stamp) -> tuple[str, ...]:
        """Units that need more time or more results before their level can be published."""
        return tuple(
            record.id
            for record in self._units.values()
            if record.latest is None
            or record.pending is not None
            or (in_grace(record, now.mono) and record.latest.level is not Level.OK and not record.published.blocked_by)
        )

    # ------------------------------------------------------------ restore after a restart of PHM

    @property
    def fault_count(self) -> int:
        """The number of the last fault that was opened."""
        return self._faults.count

    def restore(self, faults: Iterable[Fault], given_up: Iterable[Fault], now: Stamp, fault_count: int = 0) -> Effects:
        """Restore the faults that an earlier run of PHM left open or had given up, before the first result.

        fault_count: of that run. Sends no FaultOpened: it was published before. Faults of units that are no longer configured
        are closed in the returned effects, as resolved by ``configuration``.
        """
        return self._faults.restore(tuple(faults), tuple(given_up), fault_count, now)

    # ------------------------------------------------------------ results and time

    def observe(self, unit: str, result: Result, started: float, now: Stamp, duration_s: float = 0.0) -> Effects:
        """Take one result of a run that began at `started` (monotonic seconds)."""
        effects = Effects()
        record = self._units[unit]
        if started < record.started:
            return effects  # an overdue run that finished after a newer one
        unseen = record.not_observed(result)
        if (unseen or result.evidence.unobserved) and now.mono < record.unobserved_until:
            result = as_unobserved(result, unseen)
        record.latest, record.started = result, started
        record.had_error = record.had_error or record.failing
        record.error_since = (started if record.error_since is None else record.error_since) if record.failing else None
        record.bad_in_a_row = record.bad_in_a_row + 1 if result.level.bad else 0
        record.had_doubt = record.had_doubt and result.level is not Level.OK
        record.note_certain(result, started)
        record.note_end(result)
        record.duration_s = duration_s
        if record.target and result.evidence.generation:
            self._see_generation(record.target, unit, result.evidence.generation, started, now, effects)
        self._evaluate(record, now, effects)
        self._evaluate_dependents(record, now, effects)
        if unit in self._view.starved:
            self._note_starvation(record, now, effects)
        if record.published.duration_s != duration_s:  # nothing was published
            record.published = replace(record.published, duration_s=duration_s)
        effects.waiting = record.waiting or any(other.waiting for other in self._view.downstream(record.id))
        return effects

    def tick(self, now: Stamp) -> Effects:
        """Apply the passing of time: expired actions, grace and settling."""
        effects = Effects()
        for target in [target for target, action in self._actions.items() if now.mono >= action.until]:
            self._release(target, now, effects)
        effects.waiting = bool(self._actions)
        for name in self._view.starved:
            if self._units[name].starving is not None and self._units[name].unknown:
                self._note_starvation(self._units[name], now, effects)
        for record in self._units.values():
            if record.settled:
                continue  # most are, and this is called several times a second
            try:
                self._settle(record, now, effects)
            except Exception:  # a defect must not stop the time of the other units
                logger.exception("the state of %s could not be evaluated", record.id)
                effects.waiting = True
        return effects

    # ------------------------------------------------------------ recovery actions, holds and container events

    def begin_action(
        self,
        target: str,
        owner: str,
        action: str,
        now: Stamp,
        at_most_s: float,
        *,
        verifying: bool = False,
        leaves_running: bool = False,
    ) -> Effects:
        """An action begins on `target`, for the fault of unit `owner`. With `verifying`, the owner's OK is held back until
        `end_action`. Of the action that is in progress already: it gets more time."""
        before = self._actions.get(target)
        same = before is not None and (before.owner, before.action) == (owner, action)
        begun = before.begun if before is not None and same else now.mono
        until = now.mono + at_most_s
        self._actions[target] = ActionInProgress(owner, action, begun, until, verifying, leaves_running)
        for record in self._units.values():
            # The restart of a dependent is part of the action on the owner's target, which gets the credit.
            part = record.target != target and record.target in self._actions
            concerned = record.target == target and action != JOINS
            if record.fault is not None and (concerned or (record.id == owner and not part)):
                record.fault = replace(record.fault, by=action)
        return Effects()

    def end_action(self, target: str, now: Stamp, *, worked: bool) -> Effects:
        """The action on `target` is over. If `worked` is false, later recoveries are not credited to it."""
        effects = Effects()
        action = self._actions.get(target)
        self._release(target, now, effects)
        if action is None:
            return effects
        if action.verifying:
            # The owner's results from the meantime count now, or not yet.
            owner = self._units[action.owner]
            owner.unverified_from, owner.unverified_until = now.mono, NEVER if worked else now.mono + UNVERIFIED_S
            if worked:
                self._evaluate(owner, now, effects)
        if not worked:
            self._clear_credit(target, action)
        return effects

    def action_not_needed(self, target: str) -> Effects:
        """The action in progress on `target` found nothing to do: no fault that ends is credited to it."""
        action = self._actions.get(target)
        if action is not None:
            action.needed = False
            self._clear_credit(target, action)
        return Effects()

    def clear_action_credit(self, unit: str) -> Effects:
        """The action for the unit's fault did not help: later recoveries are not credited to it."""
        record = self._units[unit]
        if record.fault is not None:
            record.fault = replace(record.fault, by="")
        return Effects()

    def action_on(self, target: str) -> str:
        """The recovery action in progress on the target; empty: none."""
        action = self._actions.get(target)
        return action.action if action is not None else ""

    def put_on_hold(self, target: str, words: str, conditions: frozenset[str], now: Stamp) -> Effects:
        """The target is on hold until `end_hold`: see `TargetHold`. A new hold replaces an old one."""
        effects = Effects()
        self._holds[target] = TargetHold(words, conditions)
        for record in self._units.values():
            if record.target == target:
                self._evaluate(record, now, effects)
        return effects

    def end_hold(self, target: str, now: Stamp) -> Effects:
        """The hold is over: what is still bad after its grace becomes a fault as soon as a new run confirms it."""
        effects = Effects()
        if self._holds.pop(target, None) is not None:
            self._invalidate_target(target, now, effects)
        return effects

    def expect_stop(self, target: str, now: Stamp, at_most_s: float) -> Effects:
        """The container received a stop signal and has this long to exit: its parts disappear first, which is not a fault.

        Parts are units of the target that depend on another unit of it; the container's own unit is evaluated as usual.
        """
        self._stops[target] = now.mono + at_most_s
        for record in self._units.values():
            if record.target == target and self._view.is_part(record.id):
                record.grant(now.mono, now.mono)  # earlier symptoms may already be due to the stop
        return Effects()

    def container_ended(self, target: str, now: Stamp) -> Effects:
        """An event reports that the container has exited: earlier results of its parts may follow from that.

        The container and its parts run again before anything is published about a part. No grace is given.
        """
        effects = Effects()
        self._stops.pop(target, None)
        self._outdate(target, now, effects)
        return effects

    def is_stopping(self, target: str, now: float) -> bool:
        return self._view.stopping(target, now)

    def container_started(self, target: str, now: Stamp) -> Effects:
        """An event reports a start of the container: its dependents get grace, once per generation."""
        effects = Effects()
        self._stops.pop(target, None)
        if self._starts.on_event(target, now.mono):
            self._restarted(target, now, effects)
        return effects

    def escalate(self, fault_id: str, now: Stamp) -> Effects:
        """Recovery has given up on this fault: close it as escalated. The unit stays ERROR until it is OK."""
        effects = Effects()
        for record in self._units.values():
            if record.fault is not None and record.fault.id == fault_id:
                record.given_up, record.escalated = record.fault, True
                self._faults.close(record, Outcome.ESCALATED, "", now, effects)
        return effects

    def clear_given_up(self, units: Iterable[str], now: Stamp) -> Effects:
        """There is a reason to try again: after grace, units that were given up may open faults again."""
        effects = Effects()
        given_up = [self._units[name] for name in units if name in self._units and self._units[name].escalated]
        for record in given_up:
            record.clear_given_up()
        self._give_grace([record.id for record in given_up], now, effects)
        for record in given_up:
            if record.published.level is Level.ERROR:  # no fault until a new result confirms it
                self._publish(record, as_unknown(record.published.result), now, effects)
        return effects

    # ------------------------------------------------------------ internal

    def _settle(self, record: UnitRecord, now: Stamp, effects: Effects) -> None:
        if record.unpublished:
            self._evaluate(record, now, effects)
        effects.waiting |= record.waiting
        if starvation.recovering(record, now.mono) and now.mono - record.started >= ASK_AGAIN_S:
            effects.rerun.add(record.id)
        if record.pending is not None:
            waiting = (record, *self._view.upstream(record.id), *starvation.pressure_units(record, self._view))
            effects.rerun.update(other.id for other in waiting if now.mono - other.started >= ASK_AGAIN_S)
            if record.spec.unit.settle_s > 0 and now.mono - record.started >= SETTLING_RERUN_S:
                effects.rerun.add(record.id)

    def _evaluate(self, record: UnitRecord, now: Stamp, effects: Effects) -> None:
        decision = decide(record, self._view, now.mono)
        if decision is None or record.latest is None:
            return
        record.pending = decision.pending
        effects.rerun |= decision.rerun
        if record.latest.level is not Level.OK:
            record.ok_since = None
        if decision.publish is None:
            return
        if decision.blocked_by:
            self._attribute(record, decision.publish, decision.blocked_by, now, effects)
        elif decision.publish.level is Level.OK or (
            decision.publish.ends_fault and (record.fault is not None or record.escalated)
        ):
            self._recovered(record, decision.publish, now, effects)
        else:
            self._publish(record, decision.publish, now, effects)

    def _evaluate_dependents(self, record: UnitRecord, now: Stamp, effects: Effects) -> None:
        for other in self._view.downstream(record.id):
            if other.latest is not None and other.latest.level is not Level.OK:
                self._evaluate(other, now, effects)

    def _note_starvation(self, record: UnitRecord, now: Stamp, effects: Effects) -> None:
        """A pressure unit has a new result: evaluate symptoms that wait for it, and all symptoms if starvation began or ended."""
        change = starvation.observe(record, now.mono)
        # All are marked before the first is evaluated, because units depend on each other.
        for other in self._view.starved[record.id] if change.ended else ():
            starvation.ended(other, record.id, change.below_from)
        for other in self._view.starved[record.id]:
            if other.latest is None or not other.latest.level.bad:
                continue
            if change.ended:
                effects.rerun.add(other.id)
            if change.began or change.ended or other.pending is not None:
                self._evaluate(other, now, effects)

    def _recovered(self, record: UnitRecord, result: Result, now: Stamp, effects: Effects) -> None:
        recovered = record.had_error or record.published.level is Level.ERROR or bool(record.published.blocked_by)
        reported = record.reported
        record.had_error = record.reported = False
        record.clear_given_up()
        if result.level is Level.OK:
            self._count_ok(record, now)
            self._publish(record, result, now, effects)
        if record.fault is not None:
            # What was observed in this run has ended in this run.
            restored = record.unobserved_until != NEVER
            unobserved = restored and (result.evidence.unobserved or record.not_observed(result))
            by = TIMEOUT if unobserved else record.ended_by or record.fault.by or ITSELF
            self._faults.close(record, Outcome.RESOLVED, by, now, effects)
        record.restored_subjects, record.unobserved_until = frozenset(), NEVER
        if result.level is not Level.OK:  # another problem, reported after the end of the first
            self._publish(record, result, now, effects)
        if recovered:
            # Problems of its dependents meanwhile, published or not, may follow from it.
            below = self.graph.downstream(record.id)
            (self._give_grace if reported else self._give_grace_once)(below, now, effects)

    @staticmethod
    def _count_ok(record: UnitRecord, now: Stamp) -> None:
        """It is OK: its grace ends once that has lasted."""
        record.ok_since = now.mono if record.ok_since is None else record.ok_since
        if now.mono - record.ok_since >= max(GRACE_ENDS_AFTER_OK_S, record.spec.unit.memory_s):
            record.grace_until = min(record.grace_until, now.mono)
            record.symptom_grace_from = NEVER

    def _attribute(self, record: UnitRecord, result: Result, cause: str, now: Stamp, effects: Effects) -> None:
        self._faults.close(record, Outcome.REATTRIBUTED, cause, now, effects)
        if result is not record.published.result:  # else it was published before, blocked by the same cause
            self._publish(record, result, now, effects, blocked_by=cause)
        causing = self._units[cause]
        record.reported = record.reported or causing.published.level is Level.ERROR
        if causing.fault is not None and record.id not in causing.fault.blocks:
            causing.fault = replace(causing.fault, blocks=(*causing.fault.blocks, record.id))

    def _clear_credit(self, target: str, action: ActionInProgress) -> None:
        for record in self._units.values():
            own = record.target == target or record.id == action.owner
            if own and record.fault is not None and record.fault.by == action.action:
                record.fault = replace(record.fault, by="")

    def _release(self, target: str, now: Stamp, effects: Effects) -> None:
        if self._actions.pop(target, None) is not None:
            self._invalidate_target(target, now, effects)

    def _invalidate_target(self, target: str, now: Stamp, effects: Effects) -> None:
        """Earlier results of the target and of its dependents no longer count."""
        touched = [record.id for record in self._units.values() if record.target == target]
        below = {name for unit in touched for name in self.graph.downstream(unit)}
        self._give_grace([*touched, *sorted(below.difference(touched))], now, effects)

    def _see_generation(
        self, target: str, unit: str, generation: str, started: float, now: Stamp, effects: Effects
    ) -> None:
        """A check saw the container in this generation; results from before a new generation do not count."""
        saw = self._starts.on_result(target, unit, generation, started)
        if saw is StartSeen.NEW:
            self._restarted(target, now, effects)
        elif saw is StartSeen.ANNOUNCED:
            self._outdate(target, now, effects)

    def _outdate(self, target: str, now: Stamp, effects: Effects) -> None:
        """Earlier bad results of the target's dependents no longer count."""
        for name in self._dependents_of(target):
            record = self._units[name]
            record.grant(now.mono, now.mono)
            if record.latest is not None and record.latest.level is not Level.OK:
                effects.rerun.add(name)

    def _dependents_of(self, target: str) -> Iterable[str]:
        """All units that depend on a unit of the target."""
        own = [record.id for record in self._units.values() if record.target == target]
        return dict.fromkeys(name for unit in own for name in self.graph.downstream(unit))

    def _restarted(self, target: str, now: Stamp, effects: Effects) -> None:
        self._stops.pop(target, None)
        for record in self._units.values():
            if record.target == target:
                record.record_start(now.mono, by_phm=target in self._actions)
        self._give_grace(self._dependents_of(target), now, effects)

    def _give_grace(self, units: Iterable[str], now: Stamp, effects: Effects) -> None:
        """Earlier results no longer count: run the checks again and allow time to recover."""
        for name in units:
            record = self._units[name]
            record.grant(now.mono, now.mono + record.spec.unit.grace_s)
            record.had_doubt = False
            if record.latest is not None and record.latest.level is not Level.OK:
                effects.rerun.add(name)

    def _give_grace_once(self, units: Iterable[str], now: Stamp, effects: Effects) -> None:
        """After a failure that was never published: no further grace until the unit was OK. Else a dependency that fails now and then
        would hide it for good."""
        for name in units:
            record = self._units[name]
            if record.had_doubt:
                record.ask_again(now.mono)
                effects.rerun.add(name)
                continue
            self._give_grace([name], now, effects)
            record.had_doubt = record.latest is not None and record.latest.level is not Level.OK

    def _publish(self, record: UnitRecord, result: Result, now: Stamp, effects: Effects, blocked_by: str = "") -> None:
        old, level = record.published, result.level
        changed = old.level is not level
        reworded = not changed and level.bad and _statement(old.result) != _statement(result)
        since = now if changed else old.since
        before = record.fault or record.given_up
        if level is Level.ERROR:
            record.reported = True
            action = self._actions.get(record.target)
            credited = action is not None and action.needed and action.action != JOINS
            by = action.action if action is not None and credited and certain_before(record, action) else ""
            self._faults.open(record, result, now, effects, by)
            self._withdraw_credit(record)
        if reworded or (level is Level.ERROR and before is not None and _basis(before.result) != _basis(result)):
            record.update_condition(result)
        if changed and old.level is Level.OK and level is not Level.ERROR:
            record.note_ok_end(now.mono)
        if changed:
            record.ok_before_s = record.ok_since_start_s(now.mono)
        fault = record.fault.id if record.fault is not None else ""
        record.published_from = record.latest
        # Not `replace`, which takes three times as long: this is done for each result.
        record.published = UnitState(
            old.unit, old.check, old.slot, old.layer, level, result, since, blocked_by, fault, record.duration_s
        )
        if changed or reworded:
            effects.events.append(Transition(now, old.level, record.published, changed_text=reworded))
        if changed and level is Level.ERROR:
            self._evaluate_dependents(record, now, effects)

    def _withdraw_credit(self, record: UnitRecord) -> None:
        """It still fails after an action on its target and the grace that follows: what ends it later is something else."""
        acting = record.target in self._actions or any(each.owner == record.id for each in self._actions.values())
        if record.fault is not None and record.fault.by and not acting and record.started > record.grace_until:
            record.fault = replace(record.fault, by="")


def _statement(result: Result) -> tuple[str, str, str]:
    """What reporters and recovery take from a bad result: another one changes the fault that is open."""
    return result.condition, result.brief, result.target


def _basis(result: Result) -> tuple[object, ...]:
    """What recovery decides by, and a restart of PHM: the statement, and the evidence that they read. Other evidence may differ in each
    run."""
    evidence = result.evidence
    return *_statement(result), evidence.never_ok, evidence.patient, evidence.file, evidence.listed, evidence.subjects
