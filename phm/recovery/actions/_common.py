"""Functions that several actions share."""

from __future__ import annotations

from phm.facts import ContainerFact
from phm.recovery.base import ActionContext, ActionFailed, container_settings
from phm.recovery.target import Target


def present(target: Target, context: ActionContext) -> ContainerFact:
    """The engine's view of the target. Raises ActionFailed when there is none."""
    key = container_settings(target).key
    fact = context.container(key)
    if fact is None:
        raise ActionFailed(f"there is no container {key}: create it, e.g. docker compose up -d")
    return fact
