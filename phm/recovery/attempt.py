"""One attempt to recover from a fault: lock the target, act, verify, release."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import cast

from phm.checking.pipeline import Pipeline
from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Fault, Phase
from phm.facts import CannotTell, NotPermitted
from phm.recovery.base import Action, ActionContext, ActionFailed, NotNeeded, NotYet
from phm.recovery.containers.container_generation import GenerationTracker
from phm.recovery.safety.armed_state import ArmedState
from phm.recovery.safety.flight_critical import FlightCriticalError, FlightCriticalGuard, Impact
from phm.recovery.safety.guarded_engine import GuardedEngine
from phm.recovery.safety.target_locks import TargetBusy, TargetLocks
from phm.recovery.target import Target
from phm.recovery.verification import VerificationHooks, VerificationResult, Verifier
from phm.transport.docker import DockerEngine

logger = logging.getLogger(__name__)

MARGIN_S = 20.0
"""Beyond the action's deadline and `verify`, the action hold lasts this long: what needs the target may recover last."""
OTHER_CAUSE_S = 5.0
"""`Action.other_cause` must answer within this time."""


@dataclass(frozen=True, slots=True)
class ActionResult:
    """What an action has done: a sentence for the log, and whether it was done.

    refused:    PHM is not permitted to do it.
    forbidden:  not done: the vehicle was armed between the decision and the call to the engine.
    postponed:  not done: something that the action needs is missing.
    not_needed: there was nothing to do.
    """

    detail: str
    ok: bool = False
    refused: bool = False
    forbidden: bool = False
    postponed: bool = False
    not_needed: bool = False


@dataclass(frozen=True, slots=True)
class AttemptOutcome:
    """Whether an attempt worked, and a sentence for the log.

    refused:     PHM is not permitted to act; the action is not tried again for this fault.
    superseded:  the container was started by something else meanwhile: it gets its grace before the next attempt.
    not_counted: the failure says nothing about the target (`phm.recovery.history`).
    forbidden:   not done: the vehicle was armed meanwhile.
    postponed:   not done: something that the action needs is missing. This does not count as an attempt.
    undecided:   only time can show whether it worked; until then the attempt has not failed.
    partly:      the unit itself recovered, but not everything that depends on it.
    """

    worked: bool
    detail: str
    refused: bool = False
    superseded: bool = False
    not_counted: bool = False
    forbidden: bool = False
    postponed: bool = False
    undecided: bool = False
    partly: bool = False

    @property
    def phase(self) -> Phase:
        """The phase in which the action is now."""
        if self.worked:
            return Phase.VERIFIED
        if self.postponed or self.forbidden:
            return Phase.REFUSED
        return Phase.DONE if self.undecided else Phase.FAILED


class Attempt:
    """`begin`, then `run`, then `release`. It owns its locks and action holds (`phm.recovery.safety.target_locks`)."""

    def __init__(
        self,
        target: Target,
        fault: Fault,
        action_type: type[Action],
        *,
        last: bool,
        approved_at: ArmedState | None = None,
        context: ActionContext,
        pipeline: Pipeline,
        clock: Clock,
        locks: TargetLocks,
        generations: GenerationTracker,
        guard: FlightCriticalGuard,
        verifier: Verifier,
        verify_s: float,
    ) -> None:
        """last: no step of the ladder follows. approved_at: the armed state at which an operator approved it; None: not.
        verify_s: limit of the verification.
        """
        self._target, self._fault, self._last, self._approved_at = target, fault, last, approved_at
        self._type, self._action = action_type, action_type()
        self._context, self._pipeline, self._clock, self._locks = context, pipeline, clock, locks
        self._generations, self._guard, self._verifier, self._verify_s = generations, guard, verifier, verify_s
        self._engine = GuardedEngine(context.engine, guard, self._forbids)
        # An action that does not disturb its target does not suppress the target's faults either.
        name = target.name
        self._held = name if action_type.impact is not Impact.OTHERS else f"{action_type.name}:{name}"
        self._began, self._credited = clock.mono(), True
        self._result: list[ActionResult] = []
        self._go, self._finished, self._abandoned = threading.Event(), threading.Event(), False

    def waits_for(self) -> str:
        """What the action needs and is missing; empty also when it cannot be determined: then the action says what is wrong."""
        try:
            return self._action.waits_for(self._target, self._fault, self._context)
        except (CannotTell, ActionFailed):
            return ""
        except Exception:  # plug-in code
            logger.exception("action %s failed to say what it waits for", self._type.name)
            return ""

    def begin(self) -> bool:
        """Lock the target and hold its faults; False when nothing was begun, which does not count as an attempt.

        That is so while another attempt acts on the target, while the container has got a signal to stop (it must not be
        killed before its time to stop is over), and when no thread can be started.
        """
        name = self._target.name
        if self._pipeline.is_stopping(name) or not self._locks.acquire(name, self):
            return False
        thread = threading.Thread(target=self._in_thread, name=f"phm-act-{self._type.name}-{name}", daemon=True)
        if not threads.start_now(thread):
            self._unlock()
            return False
        at_most_s = self._type.deadline_s + self._verify_s + MARGIN_S
        proving = self._held == name
        self._locks.start_hold(self._held, self, self._fault.unit, self._type.name, at_most_s, proving=proving)
        return True

    def run(
        self,
        report: Callable[[Phase, str], None],
        stopping: Callable[[], bool],
        wanted: Callable[[], bool] = lambda: False,
    ) -> AttemptOutcome:
        """Act and verify. wanted: whether another fault of the target calls for an action (`VerificationHooks`)."""
        name, target = self._type.name, self._target.name
        report(Phase.STARTED, f"{name} {target} for: {self._fault.result.summary}")
        result = self._act()
        if not result.ok:
            return AttemptOutcome(
                False,
                result.detail,
                result.refused,
                not_counted=result.forbidden or result.postponed,
                forbidden=result.forbidden,
                postponed=result.postponed,
            )
        report(Phase.DONE, result.detail)
        hooks = VerificationHooks(stopping, self._end_hold, wanted)
        verified = self._verifier.verify(self._fault, target, self._action, hooks)
        return self._outcome(verified, not_needed=result.not_needed)

    def release(self, *, worked: bool) -> None:
        """End the hold, and unlock the target if that has not happened."""
        self._unlock()
        if worked and not self._credited:
            self._pipeline.clear_action_credit(self._fault.unit)
        self._locks.end_hold(self._held, self, worked=worked)
        if not worked:
            self._pipeline.clear_action_credit(self._fault.unit)

    # ------------------------------------------------------------ verifying

    def _outcome(self, verified: VerificationResult, *, not_needed: bool) -> AttemptOutcome:
        name, target, unit = self._type.name, self._target.name, self._fault.unit
        if verified.superseded_by:
            words = f"{target} was started again {verified.superseded_by} before {name} was verified"
            return AttemptOutcome(False, words, superseded=True, not_counted=verified.not_counted)
        # After the last step nothing more can be done for what has not recovered: it is reported as separate faults.
        if not verified.missing or (self._last and verified.missing != unit):
            words = f"{unit} is OK again {self._clock.mono() - self._began:.1f} s after the action began"
            other = "there was nothing to do" if not_needed else self._other_cause()
            self._credited = not other
            return AttemptOutcome(True, f"{words}; the action {name} did not cause this: {other}" if other else words)
        if verified.undecided:
            words = f"{name} {target}: it is not yet known whether {unit} is OK; PHM waits"
            return AttemptOutcome(False, words, undecided=True)
        words = f"{name} {target} did not recover {verified.missing}"
        return AttemptOutcome(False, words, not_counted=verified.not_counted, partly=verified.partly)

    def _end_hold(self) -> None:
        self._locks.end_hold(self._held, self, worked=True)

    def _other_cause(self) -> str:
        """What else has made the unit OK, see `Action.other_cause`; a plug-in that hangs or crashes says nothing."""
        causes: list[str] = []

        def ask() -> None:
            with contextlib.suppress(CannotTell):
                causes.append(self._action.other_cause(self._target, self._fault, self._context))

        name = f"phm-credit-{self._type.name}-{self._target.name}"
        thread = threading.Thread(target=ask, name=name, daemon=True)
        if threads.start_now(thread):
            thread.join(OTHER_CAUSE_S)
        return causes[0] if causes else ""

    # ------------------------------------------------------------ acting

    def _act(self) -> ActionResult:
        """Run the action and unlock the target. A plug-in that hangs costs its deadline and no more."""
        self._go.set()
        try:
            if self._clock.wait(self._finished, self._type.deadline_s):
                return self._result[0]
            return ActionResult(f"{self._type.name} did not return within {self._type.deadline_s:g} s")
        finally:
            self._unlock()

    def _unlock(self) -> None:
        """From now on others may act on the target; an action that still runs begins nothing more."""
        self._abandoned = True
        self._go.set()
        self._locks.release(self._target.name, self)

    def _in_thread(self) -> None:
        self._go.wait()
        try:
            if not self._abandoned:
                self._result.append(self._run_action())
        finally:
            self._finished.set()

    def _run_action(self) -> ActionResult:
        context = replace(self._context, engine=cast(DockerEngine, self._engine), lock_dependent=self._hold_dependent)
        try:
            with self._expect_start():
                said = self._action.run(self._target, self._fault, context)
            return ActionResult(str(said), ok=True, not_needed=isinstance(said, NotNeeded))
        except FlightCriticalError as error:
            return ActionResult(str(error), forbidden=True)
        except NotPermitted as error:
            return ActionResult(f"recovery is not permitted: {error}; PHM only reports this fault", refused=True)
        except NotYet as error:
            return ActionResult(str(error), postponed=True)
        except (ActionFailed, CannotTell) as error:
            return ActionResult(str(error))
        except BaseException as error:  # plug-in code, which may also exit: its thread is ours, and the attempt failed
            logger.exception("action %s crashed", self._type.name)
            return ActionResult(f"the action crashed: {type(error).__name__}: {error}")

    def _expect_start(self) -> contextlib.AbstractContextManager[None]:
        """Attribute a start of the container to PHM, unless the action starts nothing: then it is an operator's."""
        if not self._type.starts:
            return contextlib.nullcontext()
        name = self._target.name
        return self._generations.acting(name, name, self._engine.take_unanswered, lambda: self._engine.disturbs)

    def _forbids(self, key: str, impact: Impact) -> str:
        return self._guard.forbids(key, impact, self._approved_at)

    @contextlib.contextmanager
    def _hold_dependent(self, key: str, fault: Fault, action: str, at_most_s: float) -> Iterator[None]:
        """Lock a dependent; meanwhile it raises no separate faults, and its new generation is PHM's doing."""
        name = self._target.name
        with self._locks.locked_dependent(key, self, at_most_s):
            if self._abandoned:
                raise TargetBusy(f"{action} of {name} was abandoned meanwhile")
            if self._pipeline.is_stopping(key):
                raise TargetBusy(f"{key} is being stopped")
            self._locks.start_hold(key, self, fault.unit, action, at_most_s)
            try:
                with self._generations.acting(key, name, self._engine.take_unanswered, lambda: self._engine.disturbs):
                    yield
            finally:
                self._locks.end_hold(key, self, worked=True)
