"""Decides what to do about a fault. Pure: fault, history and limits in, a decision out.

The first rule that matches decides:

1. No ladder for the condition, or no step of it applies: skip.
2. A restart ends the condition only if the unit was OK earlier in this generation, and it was not: skip, unless that
   generation is due to an attempt for the same fault.
3. Recovery is off, the target is not configured or has not opted in: skip.
4. The container is on hold: wait for its end. Not decided whether an operator is stopping it: wait for that.
5. Starvation explains the condition: wait until it is over.
6. The same failure `same_failure` times, or as many failures of an action on the entire container: give up.
7. `patience_s` is not over: wait.
8. Forbidden while armed, stopped by an operator, a condition that is only advised, or mode advise: advise. Of a container that is down
   or paused, the step that only brings it back follows instead, also with an approval, if the next one is forbidden while armed.
9. Budget used up, or back-off not over: wait.
10. Else the step of the ladder that follows the number of failed attempts.

Actions on PHM's own container and links are limited by rules 1, 6, 7 and 9 only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from phm.core.backoff import pause_s
from phm.core.model import Fault
from phm.core.settings import RecoverySettings
from phm.recovery.base import ActionCatalog, Target, ladder_of
from phm.recovery.fault_cases import CLEAN_S, HOLD, AttemptRecord, History
from phm.recovery.holds.hold_registry import ALL, BEING_STOPPED, NOTHING_REQUESTED, HoldRegistry, HoldStatus
from phm.recovery.ladders import (
    ADVISED,
    AGAIN_WHILE_IT_LASTS,
    DOWN,
    GENTLE,
    LEARNED,
    ONLY_IF_OK_BEFORE,
    ONLY_IF_REACHED_BEFORE,
    PATIENT,
    START_NOTHING,
)
from phm.recovery.safety.armed_state import ArmedStatus
from phm.recovery.safety.flight_critical import FlightCriticalGuard

STARVED, START, UNPAUSE = "starved", "start", "unpause"
PAUSED = "paused"
"""Condition of a container whose processes are frozen."""
PAUSES = 2.0
"""PHM waits this many times the longest pause after which a topic came back."""
OK_AFTER_START_S, OK_AFTER_FOUND_S = 2.0, 5.0
"""How long a unit must have been OK to count as OK in this generation.

The first: after the grace of a start that PHM observed, in which nodes start and names of the previous generation disappear.
The second: where the container started before PHM. A check with better evidence overrides both
(`phm.core.model.Evidence.never_ok`).
"""
ARMED_AGAIN_S = STARVED_AGAIN_S = 2.0


@dataclass(frozen=True, slots=True)
class ActionRules:
    """What decides about actions, for every target.

    start_s: how long a start may take (`ros.grace`).
    armed:   the armed state of the vehicle now.
    guard:   None when no container is flight-critical.
    """

    settings: RecoverySettings
    start_s: float
    catalog: ActionCatalog
    holds: HoldRegistry
    armed: Callable[[], ArmedStatus]
    guard: FlightCriticalGuard | None

    def hold_status(self, target: str, now: float, *, ended: bool = False, paused: bool = False) -> HoldStatus:
        """What keeps recovery from the target on request; mostly nothing was requested. ended, paused: as of `HoldRegistry.status`."""
        if not (ended or paused) and self.holds.concerned.isdisjoint((ALL, target)):
            return NOTHING_REQUESTED
        return self.holds.status(target, now, ended=ended, paused=paused)


@dataclass(frozen=True, slots=True)
class Act:
    """Carry out the action. alone: without restarting dependents (`ActionContext.alone`)."""

    action: str
    attempt: int
    alone: bool = False


@dataclass(frozen=True, slots=True)
class Advise:
    """Report what would help; do nothing. again_at: when to decide again (monotonic seconds); None: final for this fault."""

    action: str
    why: str
    again_at: float | None = None


@dataclass(frozen=True, slots=True)
class Wait:
    """Do nothing until then (monotonic seconds). report: whether it is published, once for each `subject`."""

    until: float
    why: str
    report: bool = False
    subject: str = "wait"


@dataclass(frozen=True, slots=True)
class GiveUp:
    """Escalate to the operator. action: what would be next."""

    action: str
    why: str


@dataclass(frozen=True, slots=True)
class Skip:
    """There is nothing that PHM may or can do."""

    why: str


Decision = Act | Advise | Wait | GiveUp | Skip


def decide(
    fault: Fault,
    history: History,
    now: float,
    *,
    target: Target,
    forbids: Callable[[str], str],
    settings: RecoverySettings,
    unrestricted: frozenset[str] = frozenset(),
    approved: bool = False,
    usable: frozenset[str] | None = None,
    start_s: float = 8.0,
    hold: tuple[float, str] | None = None,
    undecided: float | None = None,
    stopped_by_hand: bool = False,
    container_wide: frozenset[str] = frozenset(),
    starved: str = "",
    given_up: bool = False,
) -> Decision:
    """What to do about `fault` at `now` (monotonic seconds).

    forbids: why an action must not be done while the vehicle may be armed; empty: it may (`phm.recovery.safety.flight_critical`).
    approved: an operator has approved this action: mode advise and the armed state do not apply.
    unrestricted: actions on PHM's own container and links: mode, opt-in and the armed state do not apply to them.
    usable: the actions that apply to this fault; other steps are left out. None: all.
    hold: until when (monotonic seconds) the container is on hold, and why; None: it is not.
    undecided: when it is decided whether an operator is stopping the container (monotonic seconds); None: it is decided.
    stopped_by_hand: an operator stopped or paused the container, and then PHM only advises (`recovery.on_manual_stop`).
    start_s: how long the parts of a container may take to start (`ros.grace`).
    container_wide: actions on the entire container: one that did not help one fault is not repeated for another.
    starved: the pressure unit that explains the condition; empty: none does.
    given_up: recovery has given up on the fault, and its container is down: only a start is tried, once per `backoff_max`.
    """
    condition = fault.result.condition
    ladder = tuple(step for step in ladder_of(condition, settings) if usable is None or step in usable)
    if not ladder:
        return Skip(f"no action is known for {condition or 'this'}")
    failures = Failures(history, fault, now, settings.verify)
    same = failures.of_the_unit()
    if _never_ok(fault, settings, start_s) and not same and not failures.tried:
        return Skip("it was never OK since its container started, so an action would not help")
    if given_up and START not in ladder:
        return Skip("only a start is tried again after recovery has given up")
    used = history.in_budget(now - settings.window, unrestricted)
    alone = given_up or (condition in DOWN and START in ladder and len(used) >= settings.budget)
    action = START if alone else _step(ladder, condition, same, settings)
    if action not in unrestricted:
        refused = _refused(target, settings, hold, undecided)
        if refused is not None:
            return refused
        if starved:
            return Wait(
                now + STARVED_AGAIN_S,
                f"{starved} is the cause; a restart would need even more of that resource",
                report=True,
                subject=STARVED,
            )
    most = 1 if _once(condition, settings) else settings.same_failure
    if not given_up and len(same) >= most and not _only_unpaused(same, action):
        goes_on = f"; PHM still tries one start every {settings.backoff_max:g} s" if condition in DOWN else ""
        return GiveUp(action, f"{_in_vain(len(same))}{goes_on}")
    elsewhere = failures.of_the_action(action) if action in container_wide and condition not in DOWN else []
    if len(elsewhere) >= most:
        return GiveUp(action, _in_vain_elsewhere(action, len(elsewhere), fault.unit))
    wait_s = patience_s(fault, settings)
    if wait_s and now < fault.opened.mono + wait_s:
        return Wait(fault.opened.mono + wait_s, "it may come back by itself")
    action, forbidden = (action, "") if action in unrestricted else _in_flight(action, ladder, condition, forbids)
    bound = action not in unrestricted and not approved
    if forbidden and bound:
        return Advise(action, forbidden, again_at=now + ARMED_AGAIN_S)
    advised = _only_advised(condition, settings, stopped_by_hand=stopped_by_hand) if bound else ""
    if advised:
        return Advise(action, advised)
    act = Act(action, len(same) + 1, alone)
    return _when(act, failures, elsewhere, settings, given_up=given_up, unrestricted=unrestricted)


def _only_unpaused(same: Sequence[AttemptRecord], action: str) -> bool:
    """Whether `action` was not tried yet, because only an unpause was possible in flight: after landing it must be."""
    return bool(same) and all(attempt.action == UNPAUSE != action for attempt in same)


def _in_flight(action: str, ladder: tuple[str, ...], condition: str, forbids: Callable[[str], str]) -> tuple[str, str]:
    """The step to take while the vehicle may be armed, with an approval, too, and why it is forbidden; empty: it is not."""
    forbidden = forbids(action)
    gentlest = START if condition in DOWN else UNPAUSE if condition == PAUSED else ""
    if forbidden and gentlest in ladder and not forbids(gentlest):
        return gentlest, ""
    return action, forbidden


def _only_advised(condition: str, settings: RecoverySettings, *, stopped_by_hand: bool) -> str:
    """Why the action is only recommended; empty: it is carried out."""
    if stopped_by_hand:
        done = "paused" if condition == PAUSED else "stopped"
        return f"it was {done} by hand, recovery.on_manual_stop is advise"
    if condition in ADVISED and condition not in settings.ladders:
        return "the topic still has data, and the cause may be outside of the container"
    return "recovery only advises" if settings.mode == "advise" else ""


def patience_s(fault: Fault, settings: RecoverySettings) -> float:
    """For how many seconds the fault must have lasted before an action: a source may pause.

    A topic that was OK for `verify` since its container started has shown how long its pauses are.
    """
    condition = fault.result.condition
    if condition not in PATIENT and not fault.result.evidence.patient:
        return 0.0
    if condition not in LEARNED or fault.ok_since_start_s < settings.verify:
        return settings.patience
    return min(settings.patience, max(settings.patience_min, PAUSES * fault.pause_s))


def _refused(
    target: Target,
    settings: RecoverySettings,
    hold: tuple[float, str] | None,
    undecided: float | None,
) -> Skip | Wait | None:
    """Why nothing may be done to the container, whatever is wrong with it."""
    if settings.mode == "off":
        return Skip("recovery is off")
    if not target.configured:
        return Skip("no container to act on")
    if not target.opted_in:
        return Skip(f"{target.name} has not opted in (recover: true)")
    if hold is not None:
        return Wait(hold[0], hold[1], report=True, subject=HOLD)
    return Wait(undecided, BEING_STOPPED) if undecided is not None else None


def _when(
    act: Act,
    failures: Failures,
    elsewhere: Sequence[AttemptRecord],
    settings: RecoverySettings,
    *,
    given_up: bool,
    unrestricted: frozenset[str],
) -> Act | Wait:
    """The action, or until when budget and back-off hold it back."""
    now, down = failures.now, failures.fault.result.condition in DOWN
    gentle, free = act.action in GENTLE, act.action in unrestricted
    recent = [] if gentle else failures.history.in_budget(now - settings.window, unrestricted, free=free)
    most = settings.budget if down or free or gentle else max(1, settings.budget - settings.reserve)
    if recent and act.alone:
        starts = (made.at for made in recent if made.action not in START_NOTHING)
        ready = max(starts, default=now - settings.backoff_max) + settings.backoff_max
        why = f"budget of {most} actions used up, one attempt every {settings.backoff_max:g} s"
        return Wait(ready, why, report=not given_up) if now < ready else act
    if len(recent) >= most:
        kept = f", {settings.budget - most} kept for a container that is down" if most < settings.budget else ""
        return Wait(recent[-most].at + settings.window, f"budget of {most} actions used up{kept}", report=True)
    ready = failures.ready_at(settings, elsewhere)
    return Wait(ready, "backing off") if now < ready else act


def _step(ladder: tuple[str, ...], condition: str, same: list[AttemptRecord], settings: RecoverySettings) -> str:
    """The step that follows this many failed attempts."""
    again = condition in AGAIN_WHILE_IT_LASTS and condition not in settings.ladders
    failed = sum(attempt.partly for attempt in same) if again else len(same)
    return ladder[min(failed, len(ladder) - 1)]


def _once(condition: str, settings: RecoverySettings) -> bool:
    return condition in ONLY_IF_OK_BEFORE and condition not in settings.ladders


def _never_ok(fault: Fault, settings: RecoverySettings, start_s: float) -> bool:
    """Whether the unit must have been OK in this generation for an action to help, and was not. If PHM itself began the generation,
    it must restore what was OK in the one before, once: a restart in an overload may leave nodes that never find each other.
    """
    condition = fault.result.condition
    reached = condition in ONLY_IF_REACHED_BEFORE and condition not in settings.ladders
    if not (reached or _once(condition, settings)):
        return False
    after_start_s = start_s + OK_AFTER_START_S
    if not reached and fault.ok_in_run_before_s >= after_start_s:
        return False
    least_s = after_start_s if fault.start_seen else OK_AFTER_FOUND_S
    known = fault.result.evidence.never_ok
    return fault.ok_since_start_s < least_s if known is None else known


def _in_vain_elsewhere(action: str, attempts: int, unit: str) -> str:
    times = "once" if attempts == 1 else f"{attempts} times"
    return f"{action} has not helped {times} on this container, and is not repeated for {unit}"


def _in_vain(attempts: int) -> str:
    return "one attempt did not help" if attempts == 1 else f"{attempts} attempts did not help"


@dataclass(frozen=True, slots=True)
class Failures:
    """What `history` says about an attempt for `fault` at `now` (monotonic seconds).

    lasting_s: a recovery that lasted for less does not count: a container that starts and exits again is failing.

    A longer time in which the unit was OK, e.g. because an operator repaired it, resets the counts. Attempts with
    `not_counted` are neither a success nor a failure.
    """

    history: History
    fault: Fault
    now: float
    lasting_s: float

    @property
    def tried(self) -> bool:
        """Whether an action for this fault may have started the present generation, also if it is not counted as a failure.

        Attempts on an earlier generation are both `backoff_reset` and `not_counted`.
        """
        return any(
            self._own(attempt) and attempt.at >= self.fault.opened.mono
            for attempt in self._within()
            if not (attempt.backoff_reset and attempt.not_counted)
        )

    def of_the_unit(self) -> list[AttemptRecord]:
        """Attempts for the same unit and condition that did not help, since the last one that did."""
        return self._failed([attempt for attempt in self._counted() if self._own(attempt)])

    def of_the_action(self, action: str) -> list[AttemptRecord]:
        """Executions of `action`, for any fault of the target, that did not help, since the last one that did.

        An execution that helped another fault and did not last counts for that fault only.
        """
        return self._failed([attempt for attempt in self._counted() if attempt.action == action])

    def ready_at(self, settings: RecoverySettings, elsewhere: Sequence[AttemptRecord] = ()) -> float:
        """Back-off: the first attempt immediately, then 1, 2, 4 ... seconds after the last, whether it helped or not.

        What helped and failed again so soon counts too, or a flapping container would be restarted without pause; an
        attempt with `backoff_reset` does not. elsewhere: attempts for other faults of the container that count as well.
        """
        mine = [attempt for attempt in self._within() if self._own(attempt)]
        others = [attempt for attempt in elsewhere if attempt not in mine]
        same = sorted((each for each in (*mine, *others) if not each.backoff_reset), key=lambda attempt: attempt.at)
        if not same:
            return self.now
        return same[-1].at + pause_s(len(same), settings.backoff, settings.backoff_max)

    def _within(self) -> list[AttemptRecord]:
        return self.history.within(self.now - CLEAN_S)

    def _counted(self) -> list[AttemptRecord]:
        """Newest first, without those before a long time in which the unit was OK."""
        since = self.fault.opened.mono if self.fault.ok_s > self.lasting_s else float("-inf")
        return [attempt for attempt in reversed(self._within()) if attempt.at >= since]

    def _own(self, attempt: AttemptRecord) -> bool:
        return (attempt.unit, attempt.condition) == (self.fault.unit, self.fault.result.condition)

    def _failed(self, newest_first: Sequence[AttemptRecord]) -> list[AttemptRecord]:
        failures: list[AttemptRecord] = []
        broke_again = self.fault.opened.mono
        for attempt in newest_first:
            if attempt.worked and broke_again - attempt.at - attempt.took_s > self.lasting_s:
                break
            if attempt.not_counted or (attempt.worked and not self._own(attempt)):
                continue
            failures.append(attempt)
            broke_again = attempt.at
        return failures
