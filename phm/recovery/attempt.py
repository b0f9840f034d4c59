"""One attempt to recover from a fault: lock the target, act, verify, release. The action gets a guarded engine."""

from __future__ import annotations

import contextlib
import inspect
import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, cast

from phm.core import threads
from phm.core.clock import Clock
from phm.core.model import Fault, Phase
from phm.facts import CannotTell, NoResponse, NotPermitted
from phm.recovery.base import (
    Action,
    ActionContext,
    ActionFailed,
    FlightCriticalError,
    Impact,
    NotNeeded,
    NotYet,
    Target,
    TargetKind,
)
from phm.recovery.ownership import SETTLED_S, Shared, TargetBusy
from phm.recovery.safety.armed_state import ArmedState
from phm.recovery.safety.flight_critical import FlightCriticalGuard
from phm.recovery.verification import VerificationHooks, VerificationResult, Verifier, other_cause
from phm.transport.docker import DockerEngine, EngineNotConnected, EngineTimeout, EngineUnreachable

logger = logging.getLogger(__name__)

MARGIN_S = 20.0
"""For the tracker an action lasts this much longer than the action's deadline and `verify`: what needs the target may recover last."""
HUNG_S = 600.0
"""An abandoned action that has not returned after this time has a defect: each call of the engine ends sooner. It then no longer blocks
its target."""
READS = frozenset(
    {
        "version",
        "list",
        "running",
        "inspect",
        "inspect_network",
        "top",
        "stat_path",
        "read_file",
        "copy_file",
        "fetch_file",
        "events",
    }
)
"""Calls that change nothing; every other one is checked."""
NOT_ABOUT_A_CONTAINER = frozenset({"create_from_image", "exec_read", "exec_exit_code"})
"""Creates a container that is never started; concern a program that `exec_create` has prepared in a named container."""
REACH = {
    "start": Impact.NOTHING,
    "unpause": Impact.NOTHING,
    "exec_detached": Impact.NOTHING,
    "put_file": Impact.NOTHING,
    "connect": Impact.NETWORK,
    "disconnect": Impact.NETWORK,
}
"""What a call takes down; a call that is not listed: the container."""
TAKES_DOWN = frozenset({"restart", "stop", "kill", "pause", "disconnect"})
BRINGS_BACK = frozenset({"start", "unpause", "connect"})
"""Calls that are never refused for what the same action took down: to stop halfway would be worse."""
STARTS = frozenset({"start", "restart"})
"""Calls that start a container; the engine may still carry them out after it gave no answer."""
BEGINS_OR_ENDS = STARTS | {"stop", "kill"}
"""Calls after which the engine reports that a container ends or starts."""


@dataclass(frozen=True, slots=True)
class AttemptOutcome:
    """Whether an attempt worked, and a sentence for the log.

    refused:     PHM is not permitted to act; the action is not tried again for this fault.
    superseded:  the container was started by something else meanwhile: it gets its grace before the next attempt.
    not_counted: the failure says nothing about the target (`phm.recovery.fault_cases`).
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
    """`begin`, then `run`, then `release`. It owns its locks and its actions in the tracker (`phm.recovery.ownership`)."""

    def __init__(
        self,
        target: Target,
        fault: Fault,
        action_type: type[Action],
        *,
        last: bool,
        approved_at: ArmedState | None = None,
        context: ActionContext,
        shared: Shared,
        guard: FlightCriticalGuard | None,
        verify_s: float,
    ) -> None:
        """last: no step of the ladder follows, or may follow now. approved_at: the armed state at which an operator approved it; None: not.
        guard: None when no container is flight-critical. verify_s: limit of the verification.
        """
        self._target, self._fault, self._last = target, fault, last
        self._type, self._action = action_type, action_type()
        self._context, self._verify_s = context, verify_s
        self._pipeline, self._clock, self._locks = shared.pipeline, shared.clock, shared.locks
        self._generations, self._verifier = shared.generations, Verifier(shared, verify_s)
        self._engine = GuardedEngine(context.engine, guard, shared.clock, approved_at)
        # An action that does not disturb its target does not suppress the target's faults either.
        name = target.name
        self._action_key = name if action_type.impact is not Impact.OTHERS else f"{action_type.name}:{name}"
        self._began, self._credited = self._clock.mono(), True
        self._result: list[str | AttemptOutcome] = []
        self._go, self._finished = threading.Event(), threading.Event()
        self._allowed_s = self._until = 0.0
        self._abandoned_at: float | None = None
        self._lock = threading.Lock()

    def waits_for(self) -> str:
        """What the action needs and is missing. Also empty if that cannot be determined: then the action reports the problem."""
        earlier = self._still_running()
        if earlier is not None and not earlier.hangs:
            return f"an earlier {earlier._type.name} for {earlier._fault.unit} still runs"
        if unanswered := self._unanswered():
            return unanswered
        try:
            return self._action.waits_for(self._target, self._fault, self._context)
        except (CannotTell, ActionFailed):
            return ""
        except BaseException:  # plug-in code: even SystemExit must not end the worker
            logger.exception("action %s failed in `waits_for`", self._type.name)
            return ""

    def _unanswered(self) -> str:
        """Why the engine does not describe the container, as a sentence; empty: it does, or there is another problem."""
        if self._target.kind is not TargetKind.CONTAINER:
            return ""
        try:
            self._context.container(self._target.name)
        except NoResponse as error:
            return str(error)
        except CannotTell:
            pass
        return ""

    def begin(self) -> bool:
        """Lock the target, and begin the action in the tracker; False when nothing was begun, which does not count as an attempt.

        Reasons: another attempt acts on the target, the container is stopping after a signal (a restart would kill it before
        its stop timeout is over), or no thread can be started.
        """
        name, allowed_s = self._target.name, self._action.limit_s(self._context)
        if self._pipeline.is_stopping(name) or not (self._locks.acquire(name, self) or self._take_over()):
            return False
        thread = threading.Thread(target=self._in_thread, name=f"phm-act-{self._type.name}-{name}", daemon=True)
        if not threads.start_now(thread):
            self._locks.release(name, self)
            return False
        self._allowed_s, self._until = allowed_s, self._clock.mono() + allowed_s
        self._begin_action()
        return True

    def run(
        self,
        report: Callable[[Phase, str], None],
        stopping: Callable[[], bool],
        wanted: Callable[[], bool] = lambda: False,
        first: Callable[[], bool] = lambda: False,
    ) -> AttemptOutcome:
        """Act and verify. wanted: whether another fault of the target calls for an action; first: for one on PHM itself
        (`VerificationHooks`)."""
        name, target = self._type.name, self._target.name
        report(Phase.STARTED, f"{name} {target} for: {self._fault.result.summary}")
        said = self._act()
        if isinstance(said, AttemptOutcome):
            return said
        if isinstance(said, NotNeeded):
            self._pipeline.action_not_needed(self._action_key)
        report(Phase.DONE, said)
        hooks = VerificationHooks(stopping, self._end_action, wanted, first)
        verified = self._verifier.verify(self._fault, target, self._action, hooks)
        return self._outcome(verified, not_needed=isinstance(said, NotNeeded))

    def release(self, *, worked: bool) -> None:
        """The action is over: unlock the target if that has not happened."""
        self._unlock()
        if worked and not self._credited:
            self._pipeline.clear_action_credit(self._fault.unit)
        self._locks.end_action(self._action_key, self, worked=worked)
        if not worked:
            self._pipeline.clear_action_credit(self._fault.unit)

    # ------------------------------------------------------------ verifying

    def _outcome(self, verified: VerificationResult, *, not_needed: bool) -> AttemptOutcome:
        name, target, unit = self._type.name, self._target.name, self._fault.unit
        if verified.superseded_by:
            words = f"{target} was started again {verified.superseded_by} before {name} was verified"
            return AttemptOutcome(False, words, superseded=True, not_counted=verified.not_counted)
        # After the last step nothing more can be done for what has not recovered: it is reported as separate faults.
        if not verified.missing or (self._last and verified.partly):
            words = f"{unit} is OK again {self._clock.mono() - self._began:.1f} s after the action began"
            other = "no action was needed" if not_needed else self._other_cause()
            self._credited = not other
            return AttemptOutcome(True, f"{words}; not credited to {name}: {other}" if other else words)
        if verified.undecided:
            words = f"{name} {target}: it is not yet known whether {unit} is OK; PHM waits"
            return AttemptOutcome(False, words, undecided=True)
        words = f"{name} {target} did not recover {verified.missing}"
        return AttemptOutcome(False, words, not_counted=verified.not_counted, partly=verified.partly)

    def _other_cause(self) -> str:
        return other_cause(self._action, self._target, self._fault, self._context)

    def _end_action(self) -> None:
        self._locks.end_action(self._action_key, self, worked=True)

    # ------------------------------------------------------------ an action that does not return

    @property
    def hangs(self) -> bool:
        """Whether the action was abandoned so long ago that no call of the engine can still be the reason."""
        return self._abandoned_at is not None and self._clock.mono() - self._abandoned_at >= HUNG_S

    def _still_running(self) -> Attempt | None:
        """An abandoned attempt whose action still runs, and has the target locked."""
        owner = self._locks.owner(self._target.name)
        return owner if isinstance(owner, Attempt) and owner._abandoned_at is not None else None

    def _take_over(self) -> bool:
        """Lock the target in place of an action that hangs; False if none does."""
        earlier = self._still_running()
        if earlier is None or not earlier.hangs:
            return False
        self._locks.release(self._target.name, earlier)
        return self._locks.acquire(self._target.name, self)

    def _allow(self, more_s: float) -> None:
        """The action may take this much longer. Raises TargetBusy if it was abandoned before."""
        with self._lock:
            if self._abandoned_at is not None:
                raise TargetBusy(f"{self._type.name} of {self._target.name} was abandoned meanwhile")
            self._allowed_s, self._until = self._allowed_s + more_s, self._until + more_s
            self._begin_action()

    def _begin_action(self) -> None:
        """Begin the action in the tracker, or extend its time there."""
        at_most_s = self._until - self._clock.mono() + self._verify_s + MARGIN_S
        self._locks.begin_action(
            self._action_key,
            self,
            self._fault.unit,
            self._type.name,
            at_most_s,
            verifying=self._action_key == self._target.name,
            leaves_running=self._type.leaves_running,
        )

    def _abandon_when_due(self) -> bool:
        """Abandon the action if its time is over. Returns whether it is."""
        with self._lock:
            if self._clock.mono() < self._until:
                return False
            self._abandoned_at = self._clock.mono()
            return True

    # ------------------------------------------------------------ acting

    def _act(self) -> str | AttemptOutcome:
        """Run the action and unlock the target. Returns what the action said, or how the attempt failed.

        An action that has not returned when its time is over is abandoned.
        """
        self._go.set()
        try:
            while not self._clock.wait(self._finished, max(0.0, self._until - self._clock.mono())):
                if self._abandon_when_due():
                    return AttemptOutcome(False, f"{self._type.name} did not return within {self._allowed_s:g} s")
            return self._result[0]
        finally:
            self._unlock()

    def _unlock(self) -> None:
        """An action that still runs begins nothing more. Others may act on the target now, or once it has returned."""
        begun = self._go.is_set()
        with self._lock:
            self._abandoned_at = self._clock.mono() if self._abandoned_at is None else self._abandoned_at
        self._engine.abandoned = True
        self._go.set()
        if self._finished.is_set() or not begun:
            self._locks.release(self._target.name, self)

    def _in_thread(self) -> None:
        self._go.wait()
        try:
            if self._abandoned_at is None:
                self._result.append(self._run_action())
        finally:
            self._finished.set()
            if self._abandoned_at is not None:
                self._locks.release(self._target.name, self)

    def _run_action(self) -> str | AttemptOutcome:
        context = replace(self._context, engine=cast(DockerEngine, self._engine), lock_dependent=self._lock_dependent)
        try:
            with self._expect_start():
                said = self._action.run(self._target, self._fault, context)
            return said if isinstance(said, NotNeeded) else str(said)
        except FlightCriticalError as error:
            return AttemptOutcome(False, str(error), not_counted=True, forbidden=True)
        except NotPermitted as error:
            words = f"recovery is not permitted: {error}; PHM only reports this fault"
            return AttemptOutcome(False, words, refused=True)
        except NotYet as error:
            return AttemptOutcome(False, str(error), not_counted=True, postponed=True)
        except (ActionFailed, CannotTell) as error:
            nothing_done = isinstance(error, NoResponse) and not self._engine.changed and bool(self._unanswered())
            return AttemptOutcome(False, str(error), not_counted=nothing_done, postponed=nothing_done)
        except BaseException as error:  # plug-in code: even SystemExit must end only this attempt
            logger.exception("action %s crashed", self._type.name)
            return AttemptOutcome(False, f"the action crashed: {type(error).__name__}: {error}")

    def _expect_start(self) -> contextlib.AbstractContextManager[None]:
        """Attribute a start of the container to PHM, unless the action starts nothing: then it is an operator's."""
        if not self._type.starts:
            return contextlib.nullcontext()
        name = self._target.name
        return self._generations.acting(name, name, self._engine.take_unanswered, self._engine.disturbs)

    @contextlib.contextmanager
    def _lock_dependent(self, key: str, fault: Fault, action: str, at_most_s: float) -> Iterator[None]:
        """Lock a dependent; meanwhile it raises no separate faults, and its new generation is attributed to PHM."""
        name = self._target.name
        self._allow(at_most_s)
        with self._locks.locked_dependent(key, self, at_most_s):
            if self._pipeline.is_stopping(key):
                raise TargetBusy(f"{key} is being stopped")
            self._allow(at_most_s)
            self._locks.begin_action(key, self, fault.unit, action, at_most_s)
            try:
                with (
                    self._approval_of_dependents(),
                    self._engine.dependent() as disturbs,
                    self._generations.acting(key, name, self._engine.take_unanswered, disturbs),
                ):
                    yield
            finally:
                self._locks.end_action(key, self, worked=True)

    def _approval_of_dependents(self) -> contextlib.AbstractContextManager[None]:
        """What an operator approved names dependents only if the action takes down others than its target."""
        return self._engine.unapproved() if self._type.impact is Impact.NOTHING else contextlib.nullcontext()


@dataclass(slots=True, eq=False)
class _Calls:
    """What an action has asked of the engine about one container. disturb_until: until when a stop of it may be the action's
    doing (monotonic seconds): from the first call that ends or starts it until a start was answered and its events have arrived.
    """

    disturb_until: float = float("-inf")


class GuardedEngine:
    """The engine as one run of an action gets it, with the methods of `DockerEngine`.

    Before each call that changes a container, the armed state is checked again: time passes between the decision and the
    call, and between the calls of one action. Such a call raises FlightCriticalError while it is forbidden. Every call of an
    action passes through here, also those of plug-ins.
    """

    def __init__(
        self,
        engine: DockerEngine,
        guard: FlightCriticalGuard | None,
        clock: Clock,
        approved_at: ArmedState | None = None,
    ) -> None:
        """guard: None when no container is flight-critical. approved_at: the armed state at which an operator approved it."""
        self._engine, self._guard, self._clock, self._approved_at = engine, guard, clock, approved_at
        self._down: set[str] = set()
        self._unanswered = 0
        self.abandoned = False
        """Whether the action was given up: it may only finish what it has begun."""
        self.changed = False
        """Whether a call that changes something was sent."""
        self._target = _Calls()
        self._dependents: list[_Calls] = []

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._engine, name)
        if name in READS or not callable(found):
            return found

        def guarded(*args: Any, **kwargs: Any) -> Any:
            given = inspect.signature(found).bind(*args, **kwargs).arguments
            self._ask(name, str(given.get("container") or given.get("ref") or ""))
            calls = (self._dependents or [self._target]) if name in BEGINS_OR_ENDS else []
            self._may_disturb(calls, float("inf"))
            self.changed = True
            try:
                result = found(*args, **kwargs)
            except EngineNotConnected:
                raise
            except (EngineTimeout, EngineUnreachable):
                self._unanswered += name in STARTS
                raise
            if name in STARTS:
                self._may_disturb(calls, self._clock.mono() + SETTLED_S)
            return result

        return guarded

    def disturbs(self) -> bool:
        """Whether the end of the target may be this action's doing now; else it is an operator's."""
        return self._clock.mono() < self._target.disturb_until

    @contextlib.contextmanager
    def dependent(self) -> Iterator[Callable[[], bool]]:
        """Calls inside this context are about a dependent, not about the target. Yields its `disturbs`."""
        calls = _Calls()
        self._dependents.append(calls)
        try:
            yield lambda: self._clock.mono() < calls.disturb_until
        finally:
            self._dependents.remove(calls)

    @staticmethod
    def _may_disturb(calls: list[_Calls], until: float) -> None:
        for each in calls:
            each.disturb_until = until

    @contextlib.contextmanager
    def unapproved(self) -> Iterator[None]:
        """Inside this context the approval does not count."""
        approved_at, self._approved_at = self._approved_at, None
        try:
            yield
        finally:
            self._approved_at = approved_at

    def take_unanswered(self) -> int:
        """How many calls that start a container were sent and not answered since the last `take_unanswered`."""
        count, self._unanswered = self._unanswered, 0
        return count

    def _ask(self, call: str, ref: str) -> None:
        """Raises FlightCriticalError, and CannotTell when the action was abandoned or the engine does not say which container is
        meant."""
        if call in NOT_ABOUT_A_CONTAINER or (call in BRINGS_BACK and ref in self._down):
            return
        if self.abandoned:
            raise CannotTell(f"{call} of {ref} was not done: the action had taken too long")
        if self._guard is not None:
            reach = REACH.get(call, Impact.CONTAINER)
            why = self._guard.refusal(call, ref, reach, self._approved_at)
            if why:
                raise FlightCriticalError(why)
        if call in TAKES_DOWN:
            self._down.add(ref)
