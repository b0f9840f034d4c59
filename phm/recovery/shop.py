"""The tools that all workers of recovery share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from phm.clock import Clock
from phm.model import Event
from phm.pipeline import Pipeline
from phm.recovery.base import Action, ActionContext


@dataclass(frozen=True)
class Shop:
    """What all targets share: the tools of the executor."""

    pipeline: Pipeline
    publish: Callable[[Event], None]
    clock: Clock
    actions: Mapping[str, type[Action]]
    context: ActionContext
    armed: Callable[[], bool]
    grace_s: Callable[[str], float]

    @property
    def free_actions(self) -> frozenset[str]:
        return frozenset(name for name, action in self.actions.items() if action.on_myself)
