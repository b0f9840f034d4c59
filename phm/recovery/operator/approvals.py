"""An operator's approval: for one action, in the situation in which it was given, and for a limited time."""

from __future__ import annotations

from collections.abc import Callable

from phm.core.clock import Clock
from phm.core.model import Phase
from phm.recovery.containers.container_generation import GenerationTracker
from phm.recovery.fault_cases import FaultCase
from phm.recovery.operator.announcements import ActionReporter, in_words
from phm.recovery.operator.approval import Approval, Situation
from phm.recovery.operator.refusals import NotApprovable, NotNow
from phm.recovery.policy import Advise, Decision, GiveUp, Skip, Wait
from phm.recovery.safety.armed_state import ArmedStatus

CHECK_S = 1.0
"""While an approval waits, the situation is compared this often with the one in which it was given."""


class Approvals:
    """Approvals for one target. lasting_s: `recovery.approval`."""

    def __init__(
        self,
        target: str,
        clock: Clock,
        generations: GenerationTracker,
        armed: Callable[[], ArmedStatus],
        lasting_s: float,
        reporter: ActionReporter,
    ) -> None:
        self._target, self._clock, self._generations = target, clock, generations
        self._armed, self._lasting_s, self._reporter = armed, lasting_s, reporter

    def grant(self, action: str) -> Approval:
        """An approval of `action` in the current situation."""
        now = self._clock.mono()
        return Approval(self._situation(action), now, now + self._lasting_s)

    def approve(self, case: FaultCase, unapproved: Decision, approved: Decision) -> str:
        """Approve what is advised for a fault; what will be done. Raises NotApprovable, and NotNow when it may be later.

        unapproved, approved: what the policy decides without and with an approval.
        """
        fault = case.fault
        if not isinstance(unapproved, Advise) and not case.refused:
            raise NotApprovable(f"nothing is advised for {fault.id}: {in_words(unapproved)}")
        if isinstance(approved, (Skip, GiveUp)):
            raise NotApprovable(f"{fault.id} cannot be approved: {in_words(approved)}")
        action = unapproved.action if isinstance(unapproved, Advise) else getattr(approved, "action", "recovery")
        approval = self.grant(action)
        if isinstance(approved, Wait) and approved.until >= approval.until:
            words = f"{approved.why}: not possible within the {self._lasting_s:g} s of an approval"
            raise NotNow(f"{words}, approve it again later")
        later = f", as soon as possible: {approved.why}" if isinstance(approved, Wait) else ""
        detail = f"approved: {action} {self._target} for {fault.unit}{later}"
        case.reported.discard(f"{Phase.ADVISED.value} {action}")
        self._reporter.report(fault, action, Phase.APPROVED, detail)
        case.refused, case.approval = False, approval
        return detail

    def void(self, case: FaultCase, action: str) -> str:
        """Why the case's approval does not hold for `action` now; empty: it does, or there is none."""
        if case.approval is None:
            return ""
        return case.approval.void(self._clock.mono(), self._situation(action))

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
