"""Approvals of one container: given in the situation of the moment, and ended, with a message, when that has changed."""

from __future__ import annotations

from collections.abc import Callable

from phm.core.model import Fault, Phase
from phm.recovery.fault_cases import FaultCase
from phm.recovery.operator.approval import Approval, Situation
from phm.recovery.shop import Shop

LOOK_S = 1.0
"""While an approval waits, the situation is compared this often with that in which it was given."""


class Approvals:
    """publish: a fault, an action, a phase and a sentence."""

    def __init__(self, target: str, shop: Shop, publish: Callable[[Fault, str, Phase, str], None]) -> None:
        self._target, self._shop, self._publish = target, shop, publish

    def grant(self, action: str) -> Approval:
        """An approval of `action` as things are now."""
        now = self._shop.clock.mono()
        return Approval(self._situation(action), now, now + self._shop.context.settings.recovery.approval)

    def void(self, case: FaultCase, action: str) -> str:
        """Why the case's approval does not hold for `action` now; empty: it does, or there is none."""
        if case.approval is None:
            return ""
        return case.approval.void(self._shop.clock.mono(), self._situation(action))

    def check(self, case: FaultCase, action: str) -> list[float]:
        """End an approval that no longer holds; else in how many seconds to look again.

        action: what would be done now; empty: nothing, it waits.
        """
        if case.approval is None:
            return []
        granted = case.approval.situation.action
        why = self.void(case, action or granted)
        if why:
            self.expire(case, granted, why)
            return []
        return [min(LOOK_S, max(0.05, case.approval.until - self._shop.clock.mono()))]

    def expire(self, case: FaultCase, action: str, why: str) -> None:
        """End the case's approval of `action`, and say so."""
        case.approval = None
        words = (
            f"the approval of {action} {self._target} no longer holds: {why}; approve it again if it is still wanted"
        )
        self._publish(case.fault, action, Phase.EXPIRED, words)

    def _situation(self, action: str) -> Situation:
        life = self._shop.lives.look(self._target)
        return Situation(action, self._shop.armed().state, f"{life.id}@{life.started}" if life is not None else "")
