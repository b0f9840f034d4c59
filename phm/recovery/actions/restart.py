"""Restart a container."""

from __future__ import annotations

from phm.model import Fault
from phm.recovery.actions._common import present, restart_dependants, restart_gracefully
from phm.recovery.base import Action, ActionContext
from phm.settings import ContainerSettings


class Restart(Action):
    """Stop gracefully (SIGTERM, stop time-out), start, then restart whoever depends on it."""

    name = "restart"
    # An application that cannot start runs for a moment, too: seen 0.1 to 0.4 s.
    proof_s = 2.0
    deadline_s = 240.0

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        restart_gracefully(present(target, context), context)
        return f"restarted {target.key}{restart_dependants(target, fault, context)}"
