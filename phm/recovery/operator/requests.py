"""What an operator requests of recovery: to carry out what is advised, or to restart a container.

Both are limited by opt-in, holds and budget like any other action. An approval is for one action, in the situation in which
it was given, and for a limited time.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from phm.core.model import Fault, Level, Phase, Result, Stamp, UnitState
from phm.core.settings import RecoverySettings
from phm.recovery.base import Target
from phm.recovery.fault_cases import ActionReporter, FaultCase, History
from phm.recovery.operator.approval import Approval, NotAllowed, NotApprovable, NotNow, Situation
from phm.recovery.ownership import Shared
from phm.recovery.policy import Act, ActionRules, Advise, Decision, GiveUp, Skip, Wait
from phm.recovery.safety.armed_state import ArmedStatus

CHECK_S = 1.0
"""While an approval waits, the situation is compared this often with the one in which it was given."""
CONDITION = "restart_requested"
RESTART = "restart"


class Approvals:
    """Approvals for one target. lasting_s: `recovery.approval`."""

    def __init__(
        self,
        target: str,
        shared: Shared,
        armed: Callable[[], ArmedStatus],
        lasting_s: float,
        reporter: ActionReporter,
    ) -> None:
        self._target, self._clock, self._generations = target, shared.clock, shared.generations
        self._armed, self._lasting_s, self._reporter = armed, lasting_s, reporter
        self._attempt_ended = float("-inf")

    def grant(self, action: str) -> Approval:
        """An approval of `action` in the current situation."""
        now = self._clock.mono()
        return Approval(self._situation(action), now, now + self._lasting_s)

    def approve(self, case: FaultCase, unapproved: Decision, approved: Decision, *, busy: str) -> str:
        """Approve what is advised for a fault; what will be done. Raises NotApprovable, and NotNow when it may be later.

        unapproved, approved: what the policy decides without and with an approval. busy: the action under way; empty: none.
        """
        fault = case.fault
        if not isinstance(unapproved, Advise) and not case.refused:
            raise NotApprovable(f"nothing is advised for {fault.id}: {in_words(unapproved)}")
        if isinstance(approved, (Skip, GiveUp)):
            raise NotApprovable(f"{fault.id} cannot be approved: {in_words(approved)}")
        if busy:  # what it achieves decides what is recommended next
            raise NotNow(f"{busy} of {self._target} is under way: approve what is recommended after it")
        action = unapproved.action if isinstance(unapproved, Advise) else getattr(approved, "action", "recovery")
        approval = self.grant(action)
        if isinstance(approved, Wait) and approved.until >= approval.until:
            words = f"{approved.why}: not possible within the {self._lasting_s:g} s of an approval"
            raise NotNow(f"{words}, approve it again later")
        later = f", as soon as possible: {approved.why}" if isinstance(approved, Wait) else ""
        detail = f"approved: {action} {self._target} for {fault.unit}{later}"
        case.reported.discard(f"{Phase.ADVISED.value} {action}")
        self._reporter.report(fault, action, Phase.APPROVED, detail)
        case.advised, case.refused, case.approval = "", False, approval
        return detail

    def void(self, case: FaultCase, action: str) -> str:
        """Why the case's approval does not hold for `action` now; empty: it does, or there is none."""
        if case.approval is None:
            return ""
        if case.approval.given < self._attempt_ended:
            return f"another action on {self._target} has ended since"
        return case.approval.void(self._clock.mono(), self._situation(action))

    def attempt_ended(self) -> None:
        """An attempt on the target has ended: approvals given before it did not know its outcome."""
        self._attempt_ended = self._clock.mono()

    def check(self, case: FaultCase, action: str) -> list[float]:
        """End an approval that no longer holds; else in how many seconds to check again.

        action: what would be done now; empty: nothing, it waits.
        """
        if case.approval is None:
            return []
        granted = case.approval.situation.action
        why = self.void(case, action or granted)
        if why:
            self.expire(case, granted, why)
            return []
        return [min(CHECK_S, max(0.05, case.approval.until - self._clock.mono()))]

    def expire(self, case: FaultCase, action: str, why: str) -> None:
        """End the case's approval of `action`, and report it."""
        case.approval = None
        words = f"the approval of {action} {self._target} expired: {why}; approve it again if it is still wanted"
        self._reporter.report(case.fault, action, Phase.EXPIRED, words)

    def _situation(self, action: str) -> Situation:
        generation = self._generations.current(self._target)
        return Situation(action, self._armed().state, generation.name if generation is not None else "")


class OperatorRequests:
    """What operators request for one target: approvals, and restarts of its container.

    `restart` may be called by any thread, the rest by the worker's.
    """

    def __init__(
        self,
        target: Target,
        history: History,
        shared: Shared,
        rules: ActionRules,
        forbids: Callable[[str], str],
        reporter: ActionReporter,
    ) -> None:
        """forbids: why an action must wait until the vehicle is disarmed; empty: it need not."""
        self._target, self._history, self._settings, self._holds = target, history, rules.settings, rules.holds
        self._forbids, self._reporter, self._unrestricted = forbids, reporter, rules.catalog.unrestricted
        self.approvals = Approvals(target.name, shared, rules.armed, rules.settings.approval, reporter)
        self._pipeline, self._clock = shared.pipeline, shared.clock
        self._case: FaultCase | None = None
        self._lock = threading.Lock()

    @property
    def pending(self) -> bool:
        """Whether a restart has been requested and has not ended."""
        return self._case is not None

    def restart(self, by: str, *, busy: bool) -> str:
        """Request a restart; what will be done. busy: an action is under way.

        Raises NotAllowed, and NotNow when it may be possible later.
        """
        self._check_limits()
        name = self._target.name
        unit = f"container/{name}"
        state = next((state for state in self._pipeline.states() if state.unit == unit), None)
        if state is None:
            raise NotAllowed(f"the check of {unit} is off: the restart could not be verified")
        with self._lock:
            if self._case is not None or busy:
                raise NotNow(f"another action on {name} is under way")
            fault = request_as_fault(state, name, by, self._clock.stamp())
            self._case = FaultCase(fault, approval=self.approvals.grant(RESTART))
        return f"restart {name}, requested by {by}"

    def next(self) -> FaultCase | None:
        """The case to restart for; None when the request was refused. Checked again each time: the autopilot may have been armed
        since, or another action may have used up the budget."""
        case = self._case
        if case is None:
            return None
        try:
            self._check_limits()
            void = self.approvals.void(case, RESTART)
            if void:
                raise NotNow(f"{self._target.name} is not restarted: {void}")
        except (NotAllowed, NotNow) as error:
            self._reporter.report(case.fault, RESTART, Phase.REFUSED, str(error))
            self._case = None
            return None
        return FaultCase(case.fault, case.reported)

    def end(self) -> None:
        """Forget the request, because the restart was tried."""
        self._case = None

    def _check_limits(self) -> None:
        status = self._holds.status(self._target.name, self._clock.mono())
        why = status.words(self._clock.stamp())
        if why:
            raise NotNow(f"{self._target.name} is {why}")
        check_permitted(
            self._target,
            self._history,
            self._clock.mono(),
            forbidden=self._forbids(RESTART),
            settings=self._settings,
            unrestricted=self._unrestricted,
        )


def check_permitted(
    target: Target,
    history: History,
    now: float,
    *,
    forbidden: str,
    settings: RecoverySettings,
    unrestricted: frozenset[str] = frozenset(),
) -> None:
    """Raises NotAllowed and NotNow. Neither mode `advise` nor back-off apply: the operator has decided. Pure.

    forbidden: why the container must not be restarted while the vehicle may be armed; empty: it may. unrestricted: actions on PHM's
    own container and links: they use up no budget of the container.
    """
    if target.container is None:
        raise NotAllowed("there is no such container in the configuration")
    if settings.mode == "off":
        raise NotAllowed("recovery is off")
    if not target.opted_in:
        raise NotAllowed(f"{target.key} has not opted in (recover: true)")
    if forbidden:
        raise NotNow(f"{target.key} is not restarted: {forbidden}")
    recent = history.in_budget(now - settings.window, unrestricted)
    if len(recent) >= settings.budget:
        left_s = recent[-settings.budget].at + settings.window - now
        raise NotNow(f"the budget of {settings.budget} actions on {target.key} is used up for {left_s:.0f} s")


def request_as_fault(state: UnitState, target: str, by: str, now: Stamp) -> Fault:
    """What the restart is done for, in the form that an attempt takes: no fault is open, so it has no id."""
    result = Result(Level.ERROR, f"requested by {by}", "restart requested", CONDITION, target)
    return Fault("", state.unit, state.slot, state.layer, result, now)


def in_words(decision: Decision) -> str:
    """Why this was decided, as part of a sentence."""
    return f"{decision.action} is about to be done" if isinstance(decision, Act) else decision.why
