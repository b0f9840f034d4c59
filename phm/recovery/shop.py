"""The tools that all workers of recovery share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from phm.checking.pipeline import Pipeline
from phm.core.clock import Clock
from phm.core.model import Event, Fault
from phm.core.settings import ContainerSettings
from phm.recovery.base import Action, ActionContext
from phm.recovery.containers.container_generation import GenerationTracker
from phm.recovery.holds.hold_registry import HoldRegistry
from phm.recovery.policy import ladder_of
from phm.recovery.safety.armed_state import ArmedStatus
from phm.recovery.safety.flight_critical import FlightCriticalGuard, Impact
from phm.recovery.safety.target_locks import TargetLocks


def _nothing_below(unit: str) -> Mapping[str, frozenset[str]]:
    return {}


@dataclass(frozen=True)
class Shop:
    """What all targets share: the tools of the executor.

    armed:   whether the vehicle is armed, as far as that is known now.
    grace_s: of a unit, seconds.
    below:   units that need a unit and are other containers', by container (`phm.checking.plan.CheckPlan.below`).
    """

    pipeline: Pipeline
    publish: Callable[[Event], None]
    clock: Clock
    actions: Mapping[str, type[Action]]
    context: ActionContext
    armed: Callable[[], ArmedStatus]
    grace_s: Callable[[str], float]
    below: Callable[[str], Mapping[str, frozenset[str]]] = _nothing_below
    holds: HoldRegistry = field(default_factory=HoldRegistry)
    hands: TargetLocks = field(init=False)
    lives: GenerationTracker = field(init=False)
    flight_critical_guard: FlightCriticalGuard = field(init=False)

    def __post_init__(self) -> None:
        verify_s = self.context.settings.recovery.verify
        object.__setattr__(self, "hands", TargetLocks(self.pipeline, self.clock))
        object.__setattr__(self, "lives", GenerationTracker(self.context.container, self.clock, verify_s))
        context = self.context
        flight_critical_guard = FlightCriticalGuard(context.settings, context.container, context.myself, self.armed)
        object.__setattr__(self, "flight_critical_guard", flight_critical_guard)

    @property
    def unrestricted_actions(self) -> frozenset[str]:
        return frozenset(name for name, action in self.actions.items() if action.on_phm_itself)

    @property
    def container_actions(self) -> frozenset[str]:
        """Actions on a container as a whole, which would help all of its faults at once."""
        whole = ((name, kind) for name, kind in self.actions.items() if kind.impact is Impact.CONTAINER)
        return frozenset(name for name, kind in whole if not kind.on_phm_itself)

    def forbids(self, target: str, action: str) -> str:
        """Why this action on `target` must wait until the vehicle is disarmed; empty: it need not."""
        kind = self.actions.get(action)
        return self.flight_critical_guard.forbids(target, kind.impact if kind is not None else Impact.CONTAINER)

    def usable(self, container: ContainerSettings | None, fault: Fault) -> frozenset[str] | None:
        """The rungs of the fault's ladder that apply to it. One that is not installed stays, to be told as such."""
        if container is None:
            return None
        return frozenset(
            rung
            for rung in self._ladder(fault)
            if rung not in self.actions or self.actions[rung].applies(container, fault, self.context.settings)
        )

    def is_last(self, container: ContainerSettings | None, fault: Fault, action: str) -> bool:
        """Whether no rung of the fault's ladder follows `action`."""
        usable = self.usable(container, fault)
        rungs = [rung for rung in self._ladder(fault) if usable is None or rung in usable]
        return action not in rungs[:-1]

    def _ladder(self, fault: Fault) -> tuple[str, ...]:
        return ladder_of(fault.result.condition, self.context.settings.recovery)
