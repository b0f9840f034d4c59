"""What several actions share: the container that must be there, a graceful restart, and who depends on it."""

from __future__ import annotations

from collections.abc import Mapping

from phm.facts import CannotTell, ContainerFact
from phm.model import Fault
from phm.recovery.base import ActionContext, ActionFailed
from phm.recovery.policy import critical_now
from phm.settings import ContainerSettings

FOLLOW_S = 30.0
"""A dependant is held for its stop time-out and this much longer, in case the thread that restarts it dies."""


def present(target: ContainerSettings, context: ActionContext) -> ContainerFact:
    """The engine's view of the target. Raises ActionFailed when there is none."""
    fact = context.container(target.key)
    if fact is None:
        raise ActionFailed(f"there is no container {target.key}: create it, e.g. docker compose up -d")
    return fact


def restart_gracefully(fact: ContainerFact, context: ActionContext) -> None:
    """SIGTERM, stop time-out, start again.

    SIGTERM first matters to ROS: a node that ends by itself takes its DDS participant with it, a killed
    one lingers in the graph until its lease ends.
    """
    if fact.status == "paused":
        context.engine.unpause(fact.id)  # a frozen process cannot act on SIGTERM
    context.engine.restart(fact.id, context.settings.recovery.stop_timeout)


def dependants(target: ContainerSettings, facts: Mapping[str, ContainerFact], context: ActionContext) -> list[str]:
    """Keys of the configured containers to be restarted after the target, in order, those of dependants included.

    A container depends on another when it lives in its network namespace, which is a new one after each
    start, or names it in `after`. Whoever depends on several comes after the last of them.
    """
    needs = {
        entry.key: {other for other in facts if _shares(facts.get(entry.key), facts[other])} | set(entry.after)
        for entry in context.settings.containers
    }
    reached = {target.key}
    grown = True
    while grown:
        found = {key for key, above in needs.items() if above & reached} - reached
        reached |= found
        grown = bool(found)
    waiting, order = [key for key in needs if key in reached and key != target.key], [target.key]
    while waiting:
        ready = [key for key in waiting if not needs[key] & set(waiting)] or waiting[:1]
        order.append(ready[0])
        waiting.remove(ready[0])
    return order[1:]


def restart_dependants(target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
    """Restart whoever depends on the target, once that runs again; what was done, for the log (may be empty).

    What goes wrong here is told and no failure of the action: the target itself has been mended, and a
    dependant that stays broken is a fault of its own.
    """
    facts = _facts(context)
    order = dependants(target, facts, context)
    if not order:
        return ""
    mended = facts.get(target.key)
    if mended is None or not mended.running:
        return f"; {', '.join(order)} not restarted, because {target.key} does not run"
    return "".join(f"; {_follow(key, fault, facts.get(key), context)}" for key in order)


def _follow(key: str, fault: Fault, fact: ContainerFact | None, context: ActionContext) -> str:
    entry = context.settings.container(key)
    if entry is None or fact is None:
        return f"{key}, which depends on it, is not there"
    if not entry.recover:
        return f"{key} depends on it and has not opted in (recover: true): restart it by hand"
    if critical_now(entry, context.armed()):
        return f"{key} depends on it, and is flight-critical while armed: restart it by hand when that is safe"
    try:
        with context.holding(key, fault, "restart", context.settings.recovery.stop_timeout + FOLLOW_S):
            restart_gracefully(fact, context)
    except CannotTell as error:
        return f"{key} depends on it and could not be restarted: {error}"
    return f"restarted {key}, which depends on it"


def _facts(context: ActionContext) -> dict[str, ContainerFact]:
    """All configured containers that can be seen now."""
    found = {}
    for entry in context.settings.containers:
        try:
            fact = context.container(entry.key)
        except CannotTell:
            continue
        if fact is not None:
            found[entry.key] = fact
    return found


def _shares(fact: ContainerFact | None, owner: ContainerFact) -> bool:
    """Whether `fact` lives in the network namespace of `owner`; the engine keeps what the user wrote, id or name."""
    mode, _, ref = fact.network_mode.partition(":") if fact is not None else ("", "", "")
    return mode == "container" and bool(ref) and (ref == owner.name or owner.id.startswith(ref))
