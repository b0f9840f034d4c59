"""Unpause a container."""

from __future__ import annotations

from phm.core.model import Fault
from phm.recovery.base import Action, ActionContext, Impact, NotNeeded, Target, present


class Unpause(Action):
    """Unpause a container."""

    name = "unpause"
    starts = False
    impact = Impact.NOTHING
    # Its processes go on running; see `Reconnect.dependents_within_s`. After a pause that is longer than their lease, PHM may lack
    # their names until it has a new participant (`phm.probes.ros.unnamed_participants`): 9.4 s in the campaign.
    dependents_within_s = 12.0

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if fact.status != "paused":
            return NotNeeded(f"{target.key} is no longer paused")
        context.engine.unpause(fact.id)
        return f"unpaused {target.key}"
