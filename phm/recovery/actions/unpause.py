"""Unpause a container."""

from __future__ import annotations

from phm.core.model import Fault
from phm.recovery.base import Action, ActionContext, Impact, NotNeeded, Target, present


class Unpause(Action):
    """Unpause a container."""

    name = "unpause"
    starts = False
    impact = Impact.NOTHING
    # Its processes go on running; see `Reconnect.dependents_within_s`.
    dependents_within_s = 6.0

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if fact.status != "paused":
            return NotNeeded(f"{target.key} is no longer paused")
        context.engine.unpause(fact.id)
        return f"unpaused {target.key}"
