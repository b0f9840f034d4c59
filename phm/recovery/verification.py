"""Verifies that an action has helped: by check runs that began after it, of the unit and of everything that needs it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from phm.core import threads
from phm.core.model import Fault, Level, Result
from phm.facts import CannotTell
from phm.recovery.base import Action, ActionContext, Target
from phm.recovery.ladders import AGAIN_WHILE_IT_LASTS, APART, DOWN, OUTSIDE
from phm.recovery.ownership import Generation, Shared, StartedBy
from phm.tracker.starvation import explanation

POLL_S = 0.05
RERUN_S = 0.5
"""While a verification waits, the checks run again this often."""
STARVED_S = 60.0
"""Dependents that starvation can explain get this much more time while it lasts: nodes need up to 50 s to start at four busy threads per core."""
OTHER_CAUSE_S = 5.0
"""`Action.other_cause` must answer within this time."""
STILL_BAD_S = 2.0
"""A run that began this long after the action (beyond the unit's grace) and is still ERROR ends the wait."""
NOT_SLOW = DOWN | AGAIN_WHILE_IT_LASTS
"""Conditions that do not mean that something starts slowly: the engine shows a container that has ended or is on no network."""


class CheckResults(Protocol):
    """What check runs have found; `phm.checking.pipeline.Pipeline` is one."""

    def found_ok(self, unit: str, mono: float) -> bool: ...

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]: ...

    def unknown_dependents(self, unit: str, mono: float) -> tuple[str, ...]: ...

    def dependencies(self, unit: str) -> tuple[str, ...]: ...

    def newest(self, unit: str, mono: float) -> Result | None: ...

    def active_pressure(self, unit: str) -> str: ...


@dataclass(frozen=True, slots=True)
class VerificationResult:
    """How a verification ended. Verified when `missing` and `superseded_by` are empty.

    missing:       the first unit that has not recovered.
    superseded_by: how the container was started again meanwhile, in words: what checks found after that says little about the
                   action.
    not_counted:   the action did not cause the failure: PHM itself started the container for another one, what is missing
                   now is outside of every container, or the unit was starved meanwhile.
    partly:        the unit itself is OK; what is missing is something that needs it.
    undecided:     only time can show whether the unit is OK (`Result.decides_s`): the action has neither helped nor failed.
    """

    missing: str = ""
    superseded_by: str = ""
    not_counted: bool = False
    partly: bool = False
    undecided: bool = False


@dataclass(slots=True)
class Verification:
    """The verification of one action that ended at `done` (monotonic seconds). Pure.

    The unit itself has `verify_s` to recover: less if it, or something in the container that it needs, is certainly still bad, more
    while its check reports that only time can show the result (a HEALTHCHECK that is `starting`). Dependents have their grace,
    unless one cannot come back by waiting (`Evidence.certain`: its process has ended, for instance), or the action is
    `proven_by_unit`. Only check runs that began `verify_after_s` after the action count; that time, `still_bad_after_s`,
    `dependents_within_s` and `proven_by_unit` are set by the action (`phm.recovery.base.Action`).
    """

    unit: str
    done: float
    verify_after_s: float
    verify_s: float
    grace_s: Callable[[str], float]
    still_bad_after_s: float | None = None
    dependents_within_s: float | None = None
    proven_by_unit: bool = False
    waiting: tuple[str, ...] = ()
    """Units that have not recovered."""
    starved: bool = False
    """Whether the unit was short of CPU, memory or disk at some time since the action."""

    def result(self, checks: CheckResults, now: float) -> VerificationResult | None:
        """The result; None: not decided yet."""
        self.waiting = (self.unit,)
        self.starved = self.starved or bool(checks.active_pressure(self.unit))
        # A unit that was starved gets the time of one more verification: its start takes longer.
        more_s = self.verify_s if self.starved else 0.0
        if not checks.found_ok(self.unit, self.done):
            return self._of_the_unit(checks, now, more_s)
        if self.proven_by_unit and checks.found_ok(self.unit, self.done + self.verify_after_s):
            return VerificationResult()
        return self._of_dependents(checks, now, more_s)

    def decides_s(self, checks: CheckResults) -> float:
        """How long the unit's check needs from the start of the container, as it says now; 0: it does not wait for time."""
        newest = checks.newest(self.unit, self.done)
        return (newest.decides_s or 0.0) if newest is not None and newest.level is Level.STALE else 0.0

    def unknown(self, checks: CheckResults) -> bool:
        """Whether the newest run since the action could not tell how the unit is."""
        newest = checks.newest(self.unit, self.done)
        return newest is not None and newest.level is Level.STALE

    def _of_the_unit(self, checks: CheckResults, now: float, more_s: float) -> VerificationResult | None:
        # While the wait lasts, nothing else is done to the container: not if it has ended meanwhile, either.
        above = ((name, checks.newest(name, self.done)) for name in checks.dependencies(self.unit))
        failing = tuple(name for name, newest in above if newest is not None and newest.level is Level.ERROR)
        self.waiting = (*failing, self.unit)
        for name in self.waiting:
            starved = self.starved and not self._is_not_slow(checks, name)
            newest = checks.newest(name, self.done + self._still_bad_s(name) + (more_s if starved else 0.0))
            if newest is not None and newest.level is Level.ERROR:
                # That PHM is not on the network counts against the action that is to end it: else PHM would never give up.
                outside = newest.condition in OUTSIDE and (name, newest.condition) != (self.unit, APART)
                return VerificationResult(missing=name, not_counted=outside or starved)
        decides_s = self.decides_s(checks)
        if now - self.done <= self.verify_s + decides_s + more_s:
            return None
        return VerificationResult(missing=self.unit, undecided=decides_s > 0, not_counted=self.starved)

    def _still_bad_s(self, unit: str) -> float:
        own_s = self.still_bad_after_s if unit == self.unit else None
        return self.grace_s(unit) + STILL_BAD_S if own_s is None else own_s

    def _is_not_slow(self, checks: CheckResults, unit: str) -> bool:
        newest = checks.newest(unit, self.done)
        return newest is not None and newest.level is Level.ERROR and newest.condition in NOT_SLOW

    def _of_dependents(self, checks: CheckResults, now: float, more_s: float) -> VerificationResult | None:
        counts_from = self.done + self.verify_after_s
        failing = checks.failing_dependents(self.unit, counts_from)
        if not failing and checks.found_ok(self.unit, counts_from):
            # An unknown dependent has not recovered, but is not missing either. One that stays unknown for `verify_s` causes
            # no further restart.
            self.waiting = checks.unknown_dependents(self.unit, counts_from)
            return None if self.waiting and now - self.done <= self.verify_s else VerificationResult()
        self.waiting = failing or self.waiting
        longest_s = self.dependents_within_s
        if longest_s is None:
            longest_s = max(self.grace_s(name) for name in self.waiting) + STILL_BAD_S + self.verify_after_s
        starved = self.starved and self._may_be_starvation(checks)
        if starved and checks.active_pressure(self.unit):
            more_s = max(more_s, STARVED_S)
        lost = self._lost(checks, counts_from)
        if not lost and now - self.done <= longest_s + (more_s if starved else 0.0):
            return None
        missing = lost or self.waiting[0]
        return VerificationResult(missing=missing, partly=missing != self.unit, not_counted=starved)

    def _lost(self, checks: CheckResults, counts_from: float) -> str:
        """The first unit that does not come back by waiting, by a run that began STILL_BAD_S after results count, and by what was
        observed after the action; empty: none."""
        results = ((name, checks.newest(name, counts_from + STILL_BAD_S)) for name in self.waiting)
        return next((name for name, newest in results if newest is not None and self._stays(newest)), "")

    def _stays(self, result: Result) -> bool:
        return result.level is Level.ERROR and result.evidence.certain and result.evidence.observed >= self.done

    def _may_be_starvation(self, checks: CheckResults) -> bool:
        """Whether starvation can explain that the first unit has not recovered.

        It cannot explain a detached network, for example. Such a failure counts: otherwise the same step would be repeated
        for as long as the machine is busy.
        """
        newest = checks.newest(self.waiting[0], self.done + self.verify_after_s)
        return newest is None or newest.level is not Level.ERROR or explanation(newest) is not None


@dataclass(frozen=True, slots=True)
class VerificationHooks:
    """Callbacks with which a long verification does not delay other work.

    stopping:  whether PHM stops.
    undecided: called once when `recovery.verify` is over and only time can show whether the unit is OK: from then on the
               other units of the container are evaluated separately.
    wanted:    whether another fault of the container calls for an action; asked only after that.
    first:     whether another fault calls for an action on PHM itself, e.g. to join the network; asked while the unit is unknown:
               it may stay so until then.
    """

    stopping: Callable[[], bool]
    undecided: Callable[[], None] = lambda: None
    wanted: Callable[[], bool] = lambda: False
    first: Callable[[], bool] = lambda: False


class Verifier:
    """Waits until verifications are decided. verify_s: `recovery.verify`."""

    def __init__(self, shared: Shared, verify_s: float) -> None:
        self._pipeline, self._clock, self._generations = shared.pipeline, shared.clock, shared.generations
        self._grace_s, self._verify_s = shared.grace_s, verify_s

    def verify(self, fault: Fault, target: str, action: Action, hooks: VerificationHooks) -> VerificationResult:
        """Verify an action that has just ended. A start of the container that the action did not cause ends the wait."""
        verification = Verification(
            fault.unit,
            self._clock.mono(),
            action.verify_after_s,
            self._verify_s,
            self._grace_s,
            action.still_bad_after_s,
            action.dependents_within_s,
            action.proven_by_unit,
        )
        expected = self._generations.current(target)
        rerun_at, undecided = float("-inf"), False
        while not hooks.stopping():
            now = self._clock.mono()
            rerun = now - rerun_at >= RERUN_S
            if rerun:
                rerun_at = now
                superseded = superseded_by(self._generations.current(target), expected, target)
                if superseded is not None:
                    return superseded
            result = verification.result(self._pipeline, now)
            if result is not None:
                return result
            if (
                not undecided
                and now - verification.done > self._verify_s
                and verification.decides_s(self._pipeline) > 0
            ):
                undecided = True
                hooks.undecided()
            if rerun and ((undecided and hooks.wanted()) or (verification.unknown(self._pipeline) and hooks.first())):
                return VerificationResult(missing=fault.unit, undecided=True)
            if rerun:
                self._pipeline.recheck(fault.unit, *verification.waiting)
            self._clock.wait(threading.Event(), POLL_S)
        return VerificationResult(missing=fault.unit)


def superseded_by(now: Generation | None, expected: Generation | None, target: str) -> VerificationResult | None:
    """How the container was started again by something else; None: it was not.

    A restart by the engine's restart policy does not count: the verification shows whether the container is OK after it.
    """
    if now is None or expected is None or now.same(expected) or now.by is StartedBy.ENGINE or now.phm_for == target:
        return None
    owner = now.phm_for
    by = f"by the recovery of {owner}" if owner else "outside PHM"
    return VerificationResult(superseded_by=by, not_counted=bool(owner))


def other_cause(action: Action, target: Target, fault: Fault, context: ActionContext) -> str:
    """What else has made the unit OK, see `Action.other_cause`; a plug-in that hangs or crashes says nothing."""
    causes: list[str] = []

    def ask() -> None:
        with contextlib.suppress(CannotTell):
            causes.append(action.other_cause(target, fault, context))

    thread = threading.Thread(target=ask, name=f"phm-credit-{action.name}-{target.name}", daemon=True)
    if threads.start_now(thread):
        thread.join(OTHER_CAUSE_S)
    return causes[0] if causes else ""
