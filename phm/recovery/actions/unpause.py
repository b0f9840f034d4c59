"""Unpause a container."""

from __future__ import annotations

from phm.core.model import Fault
from phm.recovery.actions._common import present
from phm.recovery.base import Action, ActionContext, NotNeeded
from phm.recovery.safety.flight_critical import Impact
from phm.recovery.target import Target


class Unpause(Action):
    """Unpause a container."""

    name = "unpause"
    starts = False
    impact = Impact.NOTHING

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if fact.status != "paused":
            return NotNeeded(f"{target.key} is no longer paused")
        context.engine.unpause(fact.id)
        return f"unpaused {target.key}"
