"""Lower the CPU weight of other containers to relieve a starved one."""

from __future__ import annotations

from phm.core.model import Fault
from phm.recovery.actions.cpu_weights import LOW_SHARES
from phm.recovery.actions.restart import dependents
from phm.recovery.base import Action, ActionContext, ActionFailed, ActionSettings, Impact, NotNeeded, Target
from phm.recovery.safety.namespaces import with_owners


class Relieve(Action):
    """Lower the CPU weight of the containers in `recovery.relieve`, so that a flight-critical one gets a core.

    Not of those on which a flight-critical one depends, which the engine may show and the configuration not.
    """

    name = "relieve"
    impact = Impact.OTHERS
    starts = False
    still_bad_after_s = 10.0
    verify_after_s = 1.0

    @classmethod
    def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
        container = target.container
        return container is not None and container.flight_critical and bool(settings.recovery.relieve)

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        if context.relief is None:
            raise ActionFailed("CPU weights cannot be changed here")
        lowered, needed = [], _needed(context)
        for key in context.settings.recovery.relieve:
            fact = context.container(key)
            if fact is None or not fact.running or key == target.key or key in needed or context.on_hold(key):
                continue
            if context.relief.lower(key, fact, fault.unit, context.engine):
                lowered.append(key)
        if not lowered:
            return NotNeeded("no container in recovery.relieve can be lowered")
        return f"lowered the CPU weight of {', '.join(lowered)} to {LOW_SHARES}"


def _needed(context: ActionContext) -> set[str]:
    """Containers in `recovery.relieve` on which a flight-critical one depends. Raises CannotTell."""
    containers = context.settings.containers
    facts = {entry.key: fact for entry in containers if (fact := context.container(entry.key)) is not None}
    critical = {entry.key for entry in containers if entry.flight_critical}
    facts = with_owners(critical, facts, containers, context.engine.inspect)
    return {key for key in context.settings.recovery.relieve if critical & set(dependents(key, facts, containers))}
