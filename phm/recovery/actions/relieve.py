"""Lower the CPU weight of containers that may give way to a starved one."""

from __future__ import annotations

from phm.core.model import Fault
from phm.core.settings import ContainerSettings, Settings
from phm.recovery.base import Action, ActionContext, ActionFailed, Unneeded
from phm.recovery.critical import Reach
from phm.recovery.relief import LOW_SHARES


class Relieve(Action):
    """For a flight-critical container that waits for a core because of others. `recovery.relieve` names who may give way."""

    name = "relieve"
    takes_down = Reach.OTHERS
    starts = False
    shows_s = 10.0
    proof_s = 1.0

    @classmethod
    def applies(cls, target: ContainerSettings, fault: Fault, settings: Settings) -> bool:
        return target.flight_critical and bool(settings.recovery.relieve)

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        if context.relief is None:
            raise ActionFailed("CPU weights cannot be changed here")
        lowered = []
        for key in context.settings.recovery.relieve:
            fact = context.container(key)
            if fact is None or not fact.running or key == target.key or context.on_hold(key):
                continue
            if context.relief.lower(key, fact, fault.unit, context.engine):
                lowered.append(key)
        if not lowered:
            return Unneeded("no container is left that may give way: see recovery.relieve")
        return f"lowered the CPU weight of {', '.join(lowered)} to {LOW_SHARES}"
