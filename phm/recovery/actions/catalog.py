"""The installed actions, and which of them fit a fault of a target."""

from __future__ import annotations

from collections.abc import Mapping

from phm.core.model import Fault
from phm.core.settings import Settings
from phm.recovery.base import Action
from phm.recovery.policy import ladder_of
from phm.recovery.safety.flight_critical import Impact
from phm.recovery.target import Target


class ActionCatalog:
    """By the names used in ladders.

    unrestricted:   actions on PHM's own container and links: mode, opt-in and armed state do not apply to them.
    container_wide: actions on an entire container, which would recover all of its faults.
    """

    def __init__(self, actions: Mapping[str, type[Action]], settings: Settings) -> None:
        self._actions, self._settings = actions, settings
        self.unrestricted = frozenset(name for name, action in actions.items() if action.on_phm_itself)
        self.container_wide = frozenset(
            name for name, action in actions.items() if action.impact is Impact.CONTAINER and not action.on_phm_itself
        )

    def get(self, name: str) -> type[Action] | None:
        """The action of this name; None when no installed package provides it."""
        return self._actions.get(name)

    def impact(self, name: str) -> Impact:
        """What the action takes down; an action that is not installed counts as taking its container down."""
        action = self.get(name)
        return action.impact if action is not None else Impact.CONTAINER

    def may_start(self, name: str) -> bool:
        """Whether the action may start its container; True also for one that is no longer installed."""
        action = self.get(name)
        return action is None or action.starts

    def usable(self, target: Target, fault: Fault) -> frozenset[str] | None:
        """The steps of the fault's ladder that apply to it; None when the target is not configured.

        A step that is not installed stays, so that it is reported.
        """
        if not target.configured:
            return None
        return frozenset(step for step in self._ladder(fault) if self._applies(step, target, fault))

    def is_last(self, target: Target, fault: Fault, name: str) -> bool:
        """Whether no step of the fault's ladder follows this one."""
        usable = self.usable(target, fault)
        steps = [step for step in self._ladder(fault) if usable is None or step in usable]
        return name not in steps[:-1]

    def _applies(self, step: str, target: Target, fault: Fault) -> bool:
        action = self.get(step)
        return action is None or action.applies(target, fault, self._settings)

    def _ladder(self, fault: Fault) -> tuple[str, ...]:
        return ladder_of(fault.result.condition, self._settings.recovery)
