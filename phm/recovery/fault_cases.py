"""What recovery knows about one target: what was tried, its open faults, and what changes from outside do to both.

The budget counts every attempt that disturbs the container. Two flags keep an attempt out of back-off and out of the count of failures:

- `backoff_reset`: something that the unit needs has recovered since, so the next attempt may follow immediately.
- `not_counted`: made while something that the unit needs was down, or on an earlier generation of the container
  (`phm.recovery.ownership`). The container did not cause that failure. If it counted, it would use up the attempts
  before one is made that can work. A dependency that flaps does not cause more actions than the budget allows.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace

from phm.core.clock import Clock
from phm.core.model import ActionEvent, Event, Fault, Level, Phase
from phm.recovery.ladders import DOWN, GENTLE, OUTSIDE
from phm.recovery.operator.approval import Approval
from phm.recovery.ownership import Generation, Shared

CLEAN_S = 600.0
"""After this long without an attempt, counts and back-off start again."""
KEPT = 100
"""Attempts remembered per target; more than any budget allows."""
MAX_REPORTED = 32
"""Maximum number of steps that are kept of one fault."""
HOLD = "hold"
"""The subject of a report that the target is on hold."""


@dataclass(frozen=True, slots=True)
class AttemptRecord:
    """One action that was carried out: when it began (monotonic seconds), for what, and whether it was verified."""

    at: float
    unit: str
    condition: str
    action: str
    worked: bool
    backoff_reset: bool = False
    """Back-off does not wait because of it."""
    not_counted: bool = False
    """It does not count as a failure of the target."""
    partly: bool = False
    """The unit itself recovered, but not everything that needs it."""
    took_s: float = 0.0
    """Until it was known whether it had helped."""


@dataclass(slots=True)
class History:
    """Attempts on one target, newest last, capped. The list is replaced and never changed: any thread may read it."""

    attempts: list[AttemptRecord] = field(default_factory=list)

    def add(self, attempt: AttemptRecord) -> None:
        self.attempts = [*self.attempts, attempt][-KEPT:]

    def within(self, since: float) -> list[AttemptRecord]:
        """Attempts that began at `since` (monotonic seconds) or later."""
        return [attempt for attempt in self.attempts if attempt.at >= since]

    def in_budget(self, since: float, unrestricted: Collection[str], *, free: bool = False) -> list[AttemptRecord]:
        """What counts in the budget of the container from `since` (monotonic seconds) on. free: in that of the `unrestricted` actions,
        which disturb no container."""
        return [
            made for made in self.within(since) if made.action not in GENTLE and (made.action in unrestricted) is free
        ]

    def reset_backoff(self, units: Collection[str], down_from: float) -> frozenset[str]:
        """Something that `units` need has recovered, after it was down from `down_from` (monotonic seconds).

        Returns the units with an attempt that no longer counts.
        """
        not_counted = {each.unit for each in self.attempts if each.unit in units and each.at >= down_from}
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=each.not_counted or each.at >= down_from)
            if each.unit in units
            else each
            for each in self.attempts
        ]
        return frozenset(not_counted)

    def discount_before(self, since: float) -> bool:
        """A new generation of the container began at `since` (monotonic seconds); whether an attempt counts no longer."""
        old = [each for each in self.attempts if each.at < since and not (each.backoff_reset and each.not_counted)]
        self.attempts = [
            replace(each, backoff_reset=True, not_counted=True) if each.at < since else each for each in self.attempts
        ]
        return bool(old)


@dataclass(frozen=True, slots=True)
class PersistedCase:
    """What recovery knows of one open fault. `reported` is what was published about it, so that it is not published twice.

    approved: the action that an operator has approved and that was not begun; empty: none.
    advised: the action that waits for an approval; empty: none.
    """

    reported: tuple[str, ...] = ()
    approved: str = ""
    advised: str = ""


@dataclass(frozen=True, slots=True)
class UnfinishedAction:
    """An action that had started and not ended."""

    fault: str
    attempt: AttemptRecord
    returned: bool = False
    """Its effect has not been verified, but it has ended: nothing more can be started by it."""


@dataclass(slots=True)
class FaultCase:
    """One open fault. reported: the steps that were published, so that each is published once."""

    fault: Fault
    generation: str = field(init=False)
    """Generation of the container (`Generation.name`): nothing is done in another one before the fault was found there,
    too. Empty: any."""
    reported: set[str] = field(default_factory=set)
    advised: str = ""
    """The action that was advised last and is not approved."""
    refused: bool = False
    approval: Approval | None = None
    """An operator's approval of one action. A restart of PHM ends it."""
    recheck_from: float | None = None
    """Restored, or the container was started again by others: nothing is done before a run that began after this
    (monotonic seconds) has found the unit in ERROR."""
    on_hold: bool = False
    """Whether its container was on hold at the last decision."""
    interrupted: bool = False
    """Restored, with an action under way: for the tracker that lasts until it recovers or the next action."""
    engine_was_down: bool = False
    """Whether its action waited for the Docker Engine at the last decision."""

    def __post_init__(self) -> None:
        self.generation = self.fault.generation

    def recheck_after(self, mono: float) -> None:
        """Nothing is done before a run that began at `mono` (monotonic seconds) or later has found the unit in ERROR."""
        self.recheck_from = mono if self.recheck_from is None else max(mono, self.recheck_from)

    def persisted(self) -> PersistedCase:
        """For the state file."""
        approved = self.approval.situation.action if self.approval is not None else ""
        return PersistedCase(tuple(sorted(self.reported)[:MAX_REPORTED]), approved, self.advised)

    def update_fault(self, fault: Fault) -> None:
        """The condition may have changed, and with it the actions that apply."""
        if fault.result.condition != self.fault.result.condition:
            self.refused = False
        self.fault = fault


class FaultCases:
    """By unit. Thread-safe, but for the contents of a case, which only the worker changes. over: called once with each case that is
    forgotten."""

    def __init__(self, target: str, over: Callable[[FaultCase], None] = lambda case: None) -> None:
        self._target, self._over = target, over
        self._of: dict[str, FaultCase] = {}
        self._lock = threading.Lock()

    def opened(self, fault: Fault) -> None:
        """Take over a new or changed fault."""
        with self._lock:
            case = self._of.get(fault.unit)
            if case is not None and case.fault.id == fault.id:
                case.update_fault(fault)
                return
            self._of[fault.unit] = FaultCase(fault)
        if case is not None:
            self._over(case)

    def restore(self, fault: Fault, known: PersistedCase, recheck_from: float, *, interrupted: bool) -> FaultCase:
        """The case of a fault of an earlier run of PHM. What was not permitted then may be now, so it is tried again."""
        case = FaultCase(
            fault,
            set(known.reported),
            known.advised,
            recheck_from=recheck_from,
            interrupted=interrupted,
        )
        with self._lock:
            self._of[fault.unit] = case
        return case

    def closed(self, unit: str) -> None:
        with self._lock:
            case = self._of.pop(unit, None)
        if case is not None:
            self._over(case)

    def current(self, open_faults: Callable[[], Iterable[Fault]]) -> list[FaultCase]:
        """The cases with their current faults, most upstream first. Removes those whose fault is over or has another target.

        The lock is held while the open faults are read: a case that is added meanwhile would be removed.
        """
        with self._lock:
            mine = {fault.id: fault for fault in open_faults() if fault.result.target == self._target}
            over = [case for case in self._of.values() if case.fault.id not in mine]
            self._of = {unit: case for unit, case in self._of.items() if case.fault.id in mine}
            for case in self._of.values():
                case.update_fault(mine[case.fault.id])
            current = sorted(self._of.values(), key=lambda case: case.fault.slot)
        for case in over:
            self._over(case)
        return current

    def find(self, fault_id: str) -> FaultCase | None:
        with self._lock:
            return next((case for case in self._of.values() if case.fault.id == fault_id), None)

    def persisted(self) -> dict[str, PersistedCase]:
        """The cases for the state file, by fault id."""
        with self._lock:
            cases = list(self._of.values())
        return {case.fault.id: case.persisted() for case in cases}


class ActionReporter:
    """Publishes the steps of actions on the target of this name."""

    def __init__(self, target: str, clock: Clock, publish: Callable[[Event], None]) -> None:
        self._target, self._clock, self._publish = target, clock, publish

    def report(self, fault: Fault, action: str, phase: Phase, detail: str, attempt: int = 1) -> None:
        """Publish one step."""
        stamp = self._clock.stamp()
        self._publish(ActionEvent(stamp, fault.id, fault.unit, action, self._target, phase, detail, attempt))

    def report_once(self, case: FaultCase, action: str, phase: Phase, detail: str) -> None:
        """Publish one step, unless it was published for this fault before."""
        step = f"{phase.value} {action}"
        if step not in case.reported:
            case.reported.add(step)
            if phase is Phase.ADVISED:
                case.advised = action
            self.report(case.fault, action, phase, detail)


class ExternalChanges:
    """Changes of one target that its own attempts do not cause, and what they do to its attempts and cases: the container is
    started by others, a dependency recovers, or another recovery restarts it as a dependent.

    Used by the target's worker thread, except `dependency_recovered`, which any thread may call.
    """

    def __init__(self, target: str, history: History, shared: Shared) -> None:
        self._target, self._history = target, history
        self._pipeline, self._clock, self._grace_s = shared.pipeline, shared.clock, shared.grace_s
        self._generations, self._locks = shared.generations, shared.locks
        self._generation: Generation | None = None
        self._recovered: list[tuple[Collection[str], float]] = []
        self._lock = threading.Lock()

    def dependency_recovered(self, units: Collection[str], down_from: float) -> None:
        """A dependency of these units of the target has recovered; it was down from this time on."""
        with self._lock:
            self._recovered.append((units, down_from))

    def update(self, cases: Iterable[FaultCase]) -> bool:
        """Apply the changes to the history and the cases. Returns whether further changes matter: any attempt counts, or the
        engine may still start the container for PHM."""
        given_up = [fault.unit for fault in self._pipeline.given_up() if fault.result.target == self._target]
        with self._lock:
            recovered, self._recovered = self._recovered, []
        for units, down_from in recovered:
            reset = self._history.reset_backoff(units, down_from).intersection(given_up)
            self._pipeline.clear_given_up(*reset)
            self._await_unknown(case for case in cases if case.fault.unit in units)
        counts = bool(given_up or self._history.within(self._clock.mono() - CLEAN_S))
        if not counts and self._target not in self._generations.unfinished():
            self._generations.forget(self._target)
            self._generation = None
            return False
        since = self._generations.external_start(self._target)
        if since is not None and (self._history.discount_before(since) or given_up):
            self._pipeline.note("PHM", f"{self._target} was started again outside PHM: recovery attempts reset")
            self._pipeline.clear_given_up(*given_up)
        self._follow_generation(cases)
        return True

    def attempted(
        self,
        cases: Iterable[FaultCase],
        mine: FaultCase,
        before: Generation | None,
        *,
        superseded: bool,
        undecided: bool = False,
    ) -> None:
        """An attempt on the target, for the case `mine`, has ended: the current generation is expected.

        Earlier results do not decide what to do next, for that case and for the others. The others get the grace of
        their units if the container is no longer in the generation `before`, and so does that case if it began only now: the engine
        may have started it without answering, or someone else may have. That case gets it, too, if it is `undecided` whether the
        attempt has helped. No start of a container causes what comes from OUTSIDE.
        """
        now, self._generation = self._clock.mono(), self._generations.current(self._target)
        restarted = self._generation is not None and not self._generation.same(before)
        for case in cases:
            self._expect_current(case)
            grace_s, own = self._grace_s(case.fault.unit), case.fault.id == mine.fault.id
            waits = superseded or (own and undecided) or (restarted and (not own or self._age_s(now) < grace_s))
            outside = case.fault.result.condition in OUTSIDE
            case.recheck_after(now + (grace_s if waits and not outside else 0.0))

    def _await_unknown(self, cases: Iterable[FaultCase]) -> None:
        """What they need has recovered, e.g. a node of another container: one that was unknown until then gets its grace."""
        for case in cases:
            newest = self._pipeline.newest(case.fault.unit)
            if newest is not None and newest.level is Level.STALE:
                case.recheck_after(self._clock.mono() + self._grace_s(case.fault.unit))

    def _age_s(self, now: float) -> float:
        """How long ago the current generation was first observed."""
        since = self._generation.since if self._generation is not None else None
        return now - since if since is not None else float("inf")

    def generation_changed(self, case: FaultCase) -> bool:
        """Whether the container is no longer in the generation in which the fault was found: it has already been
        restarted.

        A run that begins after the grace of that restart must then find the unit in ERROR before any action.
        """
        generation = self._generations.current(self._target)
        if generation is None or case.generation in ("", generation.name):
            return False
        case.generation = generation.name
        case.recheck_after(self._clock.mono() + self._grace_s(case.fault.unit))
        return True

    def note_hold(self, case: FaultCase, *, on_hold: bool) -> None:
        """After a hold, or once it is decided that an operator did not stop the container, a new run must confirm the fault."""
        if case.on_hold and not on_hold:
            case.reported.discard(f"{Phase.REFUSED.value} {HOLD}")
            case.recheck_after(self._clock.mono())
        case.on_hold = on_hold

    def left_down(self) -> list[Fault]:
        """Faults that recovery has given up on, of a container that was down then and is still down in a newer run."""
        last = self._history.attempts[-1].at if self._history.attempts else float("-inf")
        return [
            fault
            for fault in self._pipeline.given_up()
            if fault.result.target == self._target
            and fault.result.condition in DOWN
            and self._pipeline.confirmed_bad(fault.unit, last)
        ]

    def unconfirmed_since(self, case: FaultCase) -> float | None:
        """A run that begins after this must find the unit in ERROR before any action; None: one has."""
        recheck_from = self._recheck_from(case)
        confirmed = recheck_from is None or self._pipeline.confirmed_bad(case.fault.unit, recheck_from)
        return None if confirmed else recheck_from

    def _recheck_from(self, case: FaultCase) -> float | None:
        restarted_at = self._locks.dependent_restart_at(self._target)
        if restarted_at == float("-inf"):
            return case.recheck_from
        after_restart = restarted_at + self._grace_s(case.fault.unit)
        return after_restart if case.recheck_from is None else max(after_restart, case.recheck_from)

    def _expect_current(self, case: FaultCase) -> None:
        if self._generation is not None:
            case.generation = self._generation.name

    def _follow_generation(self, cases: Iterable[FaultCase]) -> None:
        """The container was started without an attempt: its parts get their grace. If others started it, an
        interrupted action is over. If PHM did, the engine has completed the request of an attempt late."""
        before, self._generation = self._generation, self._generations.known(self._target)
        if self._generation is None or before is None or self._generation.same(before):
            return
        now, mine = self._clock.mono(), self._generation.phm_for == self._target
        for case in cases:
            self._expect_current(case)
            if case.interrupted and not mine:
                case.interrupted = False
                self._locks.end_action(self._target, case, worked=False)
            if case.recheck_from is None or mine:
                case.recheck_after(now + self._grace_s(case.fault.unit))
