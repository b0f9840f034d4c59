"""Restart a container."""

from __future__ import annotations

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.recovery.actions._common import present, restart_dependants, restart_gracefully
from phm.recovery.actions._networks import has_its_own, missing, not_there, reconnect_stopped
from phm.recovery.base import Action, ActionContext


class Restart(Action):
    """Stop gracefully (SIGTERM, stop time-out), start, then restart its dependants.

    Not while a network that the container is to be on is missing: a restart does not bring that back, and may leave the
    container stopped.
    """

    name = "restart"
    # An application that cannot start runs for a moment, too: seen 0.1 to 0.4 s.
    verify_after_s = 2.0
    deadline_s = 240.0

    def waits_for(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        if not target.networks or not has_its_own(present(target, context)):
            return ""
        gone = missing(target.networks, context)
        return not_there(gone) if gone else ""

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if not fact.running:
            reconnect_stopped(target, fact, context)
        restart_gracefully(fact, context)
        return f"restarted {target.key}{restart_dependants(target, fault, context)}"
