"""Restart a container, and then the containers that depend on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions._networks import has_its_own, missing, not_there, reconnect_stopped
from phm.recovery.base import Action, ActionContext, FlightCriticalError, Target, container_settings, present

MOST_STOP_S = 120.0
"""PHM waits at most this long even if the container has a longer stop timeout: the container has failed already."""
CALLS = 8
"""So many calls to the engine may each take their longest time before the action is abandoned, beside the time for the stop."""
FOLLOW_CALLS = 3
"""A dependent is held for its stop timeout and this many calls, in case the thread that restarts it dies."""


class Restart(Action):
    """Stop gracefully (SIGTERM, stop timeout), start, then restart its dependents.

    Not while a configured network of the container is missing: a restart does not create it, and may leave the
    container stopped.
    """

    name = "restart"
    # An application that fails to start also runs for a moment: measured 0.1 to 0.4 s.
    verify_after_s = 2.0

    def limit_s(self, context: ActionContext) -> float:
        return restart_limit_s(context)

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        networks = container_settings(target).networks
        if not networks or not has_its_own(present(target, context)):
            return ""
        gone = missing(networks, context)
        return not_there(gone) if gone else ""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if not fact.running:
            reconnect_stopped(container_settings(target), fact, context)
        restart_gracefully(fact, context)
        return f"restarted {target.key}{restart_dependents(target, fault, context)}"


def restart_gracefully(fact: ContainerFact, context: ActionContext) -> None:
    """The container's stop signal (SIGTERM unless configured), its stop timeout, SIGKILL, start.

    SIGTERM first matters for ROS: a node that exits by itself removes its DDS participant, a killed one stays in the
    graph until its lease ends.
    """
    if fact.status == "paused":
        context.engine.unpause(fact.id)  # a frozen process cannot act on SIGTERM
    context.engine.restart(fact.id, stop_timeout_s(fact, context))


def restart_limit_s(context: ActionContext) -> float:
    """How long the restart of one container may take, whatever its own stop timeout is."""
    return max(context.settings.recovery.stop_timeout, MOST_STOP_S) + CALLS * context.engine.act_limit_s


def stop_timeout_s(fact: ContainerFact, context: ActionContext) -> float:
    """`recovery.stop_timeout`, or the container's own if longer, up to MOST_STOP_S."""
    asked_s = fact.stop_timeout_s or 0.0
    own_s = MOST_STOP_S if asked_s < 0 else min(asked_s, MOST_STOP_S)
    return max(context.settings.recovery.stop_timeout, own_s)


def restart_dependents(target: Target, fault: Fault, context: ActionContext) -> str:
    """Restart the containers that depend on the target, once it runs again. Returns what was done, for the log (may be
    empty).

    A problem here is reported and is not a failure of the action: the target itself has been restarted, and a dependent
    that does not recover is a separate fault.
    """
    facts = _facts(context)
    order = dependents(target.key, facts, context.settings.containers)
    if not order:
        return ""
    restarted = facts.get(target.key)
    if restarted is None or not restarted.running:
        return f"; {', '.join(order)} not restarted, because {target.key} does not run"
    said, moved = [], False
    for key in order:
        # Dependents of a restarted dependent must be restarted after it, however new they are.
        words, done = _follow(key, fault, facts, context, always=moved)
        moved = moved or done
        said.append(f"; {words}")
    return "".join(said)


def _follow(
    key: str, fault: Fault, facts: Mapping[str, ContainerFact], context: ActionContext, *, always: bool
) -> tuple[str, bool]:
    """What was done, for the log, and whether the dependent was restarted. facts: as observed after the target's start."""
    entry = next((entry for entry in context.settings.containers if entry.key == key), None)
    if entry is None or key not in facts:
        return f"{key}, which depends on it, does not exist", False
    if not entry.recover:
        return f"{key} depends on it and has not opted in (recover: true): restart it manually", False
    try:
        at_most_s = stop_timeout_s(facts[key], context) + FOLLOW_CALLS * context.engine.act_limit_s
        with context.lock_dependent(key, fault, "restart", at_most_s):
            skipped = _restart_dependent(entry, "" if always else facts[key].generation, context)
    except FlightCriticalError as error:
        return f"{key} depends on it: {error}; restart it manually when that is safe", False
    except CannotTell as error:
        return f"{key} depends on it and could not be restarted: {error}", False
    return skipped or f"restarted {key}, which depends on it", not skipped


def _restart_dependent(entry: ContainerSettings, before: str, context: ActionContext) -> str:
    """Restart one dependent, after checking everything again: another recovery may have locked it until now.

    before: its generation (`ContainerFact.generation`) as observed after the target's start. A dependent with another
    generation was started later than the target, regardless of the engine's clock, and is not restarted. Empty: restart
    it in any case. Returns why it was not restarted; empty: it was.
    """
    key, fact = entry.key, context.container(entry.key)
    if fact is None:
        return f"{key}, which depends on it, does not exist"
    if words := context.on_hold(key):
        return f"{key}, which depends on it, is {words}: restart it manually"
    if fact.status == "created" and not fact.error:
        # Who created it may wait for the health of others before starting it. Later its own fault has it started.
        return f"{key}, which depends on it, has not been started yet"
    if fact.running and before and fact.generation != before:
        return f"{key}, which depends on it, was started after it already"
    restart_gracefully(fact, context)
    return ""


def _facts(context: ActionContext) -> dict[str, ContainerFact]:
    """All configured containers that the engine reports now."""
    found = {}
    for entry in context.settings.containers:
        try:
            fact = context.container(entry.key)
        except CannotTell:
            continue
        if fact is not None:
            found[entry.key] = fact
    return found


def dependents(
    target: str,
    facts: Mapping[str, ContainerFact],
    containers: Sequence[ContainerSettings],
    *,
    network_only: bool = False,
) -> list[str]:
    """Keys of the containers to be restarted after the container `target`, in order, including dependents of dependents:
    of configured ones, and of others in `facts`.

    A container depends on another if it uses its network or IPC namespace, which is new after each start, or its PID
    namespace, whose processes end with the first one, or names it in `after`. One that depends on several comes after
    the last of them. network_only: only by the network namespace.
    """
    after = {entry.key: () if network_only else entry.after for entry in containers}
    needs = {
        key: {other for other in facts if _shares(facts.get(key), facts[other], network_only=network_only)}
        | set(after.get(key, ()))
        for key in dict.fromkeys([*after, *facts])
    }
    reached = {target}
    grown = True
    while grown:
        found = {key for key, above in needs.items() if above & reached} - reached
        reached |= found
        grown = bool(found)
    waiting, order = [key for key in needs if key in reached and key != target], [target]
    while waiting:
        ready = [key for key in waiting if not needs[key] & set(waiting)] or waiting[:1]
        order.append(ready[0])
        waiting.remove(ready[0])
    return order[1:]


def owners(fact: ContainerFact, *, network_only: bool) -> list[str]:
    """What the engine calls the containers whose namespaces it uses: the user's text, id or name."""
    modes = [fact.network_mode] if network_only else [fact.network_mode, fact.pid_mode, fact.ipc_mode]
    parts = [mode.partition(":") for mode in modes]
    return [ref for kind, _, ref in parts if kind == "container" and ref]


def _shares(fact: ContainerFact | None, owner: ContainerFact, *, network_only: bool) -> bool:
    """Whether `fact` uses a namespace of `owner`."""
    if fact is None:
        return False
    refs = owners(fact, network_only=network_only)
    return any(ref == owner.name or owner.id.startswith(ref) for ref in refs)
