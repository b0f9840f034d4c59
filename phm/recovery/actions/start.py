"""Start a container that has stopped."""

from __future__ import annotations

from phm.core.model import Fault
from phm.recovery.actions._networks import missing, not_there, reconnect_stopped, stale
from phm.recovery.actions.restart import CALLS, restart_dependents
from phm.recovery.base import (
    Action,
    ActionContext,
    ActionFailed,
    Impact,
    NotNeeded,
    Target,
    container_settings,
    present,
)


class Start(Action):
    """Start the container, then restart the containers that depend on it."""

    name = "start"
    impact = Impact.NOTHING
    # An application that cannot start runs for a moment, too: seen 0.1 to 0.4 s.
    verify_after_s = 2.0

    def limit_s(self, context: ActionContext) -> float:
        return CALLS * context.engine.act_limit_s

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        gone = missing(stale(container_settings(target), fact, context), context) if not fact.running else []
        return not_there(gone) if gone else ""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if fact.status == "paused":
            raise ActionFailed(f"{target.key} is paused, not stopped: unpause it")
        if fact.running:
            return NotNeeded(f"{target.key} is already running")
        reconnect_stopped(container_settings(target), fact, context)
        if not context.engine.start(fact.id):
            return NotNeeded(f"{target.key} was started outside PHM meanwhile")
        if context.alone:  # it has exited repeatedly: its dependents are not restarted each time
            return f"started {target.key}"
        return f"started {target.key}{restart_dependents(target, fact, fault, context)}"
