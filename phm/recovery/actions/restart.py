"""Restart a container, and then the containers that depend on it."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence

from phm.core.model import Fault
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions._networks import has_its_own, missing, not_there, reconnect_stopped
from phm.recovery.base import Action, ActionContext, FlightCriticalError, Target, container_settings, present
from phm.transport.docker import EngineMissing

MOST_STOP_S = 120.0
"""PHM waits at most this long even if the container has a longer stop timeout: the container has failed already."""
UP = ("running", "paused")
"""States in which a container has processes, and others may join its namespaces."""
CALLS = 8
"""So many calls to the engine may each take their longest time before the action is abandoned, beside the time for the stop."""
FOLLOW_CALLS = 3
"""A dependent is held for its stop timeout and this many calls, in case the thread that restarts it dies."""


class Restart(Action):
    """Stop gracefully (SIGTERM, stop timeout), start, then restart its dependents.

    Not while a configured network of the container is missing, or a container whose namespace it uses is down: a restart does not
    bring it back, and may leave the container stopped.
    """

    name = "restart"
    # An application that fails to start also runs for a moment: measured 0.1 to 0.4 s.
    verify_after_s = 2.0

    def limit_s(self, context: ActionContext) -> float:
        return restart_limit_s(context)

    def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
        networks, fact = container_settings(target).networks, present(target, context)
        gone = missing(networks, context) if networks and has_its_own(fact) else []
        if gone:
            return not_there(gone)
        refs = owners(fact, network_only=False) if fact.status in UP else []
        return next((why for ref in refs if (why := _down(ref, context))), "")

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        fact = present(target, context)
        if not fact.running:
            reconnect_stopped(container_settings(target), fact, context)
        restart_gracefully(fact, context)
        return f"restarted {target.key}{restart_dependents(target, fact, fault, context)}"


def _down(ref: str, context: ActionContext) -> str:
    """Why a container that uses a namespace of `ref` cannot be started now, as a sentence; empty: it can. Raises CannotTell."""
    try:
        owner = context.engine.inspect(ref)
    except EngineMissing:
        short = ref if len(ref) < 64 else ref[:12]
        return f"{short}, whose namespace it uses, was removed, and a restart would leave it stopped"
    if (owner.get("State") or {}).get("Status") in UP:
        return ""
    name = str(owner.get("Name") or ref).lstrip("/")
    return f"{name}, whose namespace it uses, does not run: PHM waits until it does"


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


def restart_dependents(target: Target, before: ContainerFact, fault: Fault, context: ActionContext) -> str:
    """Restart the containers that depend on the target, once it runs again. before: the target as it was before that.
    Returns what was done, for the log (may be empty).

    A problem here is reported and is not a failure of the action: the target itself has been restarted, and a dependent
    that does not recover is a separate fault.
    """
    facts, unknown = _facts(context)
    # The id and the name of the target, by which others share its namespaces, stay the same.
    order = dependents(target.key, {target.key: before, **facts}, context.settings.containers)
    doubt, now = unknown.pop(target.key, None), facts.get(target.key)
    named = [key for key in order if key not in unknown]
    if doubt is None and now is not None and now.running:
        said = _follow_in_order(target.key, order, fault, facts, unknown, context)
    else:
        why = f"it is not known whether {target.key} runs: {doubt}: check them manually"
        why = f"{target.key} does not run" if doubt is None else why
        said = [f"{', '.join(named)} not restarted, because {why}"] if named else []
    for key, error in unknown.items():
        said.append(f"it is not known whether {key} must be restarted, too: {error}: check it manually")
    return "".join(f"; {words}" for words in said)


def _follow_in_order(
    target: str,
    order: Sequence[str],
    fault: Fault,
    facts: Mapping[str, ContainerFact],
    unknown: Container[str],
    context: ActionContext,
) -> list[str]:
    """Restart the dependents of the target, without `unknown` ones and those of which no dependency was started again.
    Returns what was done with each, for the log.
    """
    needs = _needs(facts, context.settings.containers)
    said, started = [], {target: False}  # what was started, and whether that was after `facts` were observed
    for key in order:
        if key in unknown:
            continue
        found = needs[key] & started.keys()
        if found:
            # Dependents of a restarted dependent must be restarted after it, however new they are.
            words, after = _follow(key, fault, facts, context, always=any(started[other] for other in found))
            started.update({} if after is None else {key: after})
        else:
            left = ", ".join(other for other in order if other in needs[key])
            words = f"{key} depends on {left} and was left alone: restart it after {left}"
        said.append(words)
    return said


def _follow(
    key: str, fault: Fault, facts: Mapping[str, ContainerFact], context: ActionContext, *, always: bool
) -> tuple[str, bool | None]:
    """Restart one dependent. facts: as observed after the target's start. Returns what was done, for the log, and whether
    this action has restarted it, perhaps without an answer; None: it has not been started since.
    """
    entry = next((entry for entry in context.settings.containers if entry.key == key), None)
    if entry is None or key not in facts:
        return f"{key}, which depends on it, does not exist", None
    if not entry.recover:
        return f"{key} depends on it and has not opted in (recover: true): restart it manually", None
    asked: bool | None = None
    try:
        at_most_s = stop_timeout_s(facts[key], context) + FOLLOW_CALLS * context.engine.act_limit_s
        with context.lock_dependent(key, fault, "restart", at_most_s):
            fact, skipped = _to_restart(key, context)
            if fact is None:
                return skipped, None
            if fact.running and not always and fact.generation != facts[key].generation:
                # It was started later than the target, regardless of the engine's clock.
                return f"{key}, which depends on it, was started after it already", False
            asked = True
            restart_gracefully(fact, context)
    except FlightCriticalError as error:
        return f"{key} depends on it: {error}; restart it manually when that is safe", None
    except CannotTell as error:
        return f"{key} depends on it and could not be restarted: {error}", asked
    return f"restarted {key}, which depends on it", True


def _to_restart(key: str, context: ActionContext) -> tuple[ContainerFact | None, str]:
    """A dependent that may be restarted, after checking everything again: another recovery may have locked it until now.
    None: it may not, with the reason.
    """
    fact = context.container(key)
    if fact is None:
        return None, f"{key}, which depends on it, does not exist"
    if words := context.on_hold(key):
        return None, f"{key}, which depends on it, is {words}: restart it manually"
    if fact.status == "created" and not fact.error:
        # Who created it may wait for the health of others before starting it. Later its own fault has it started.
        return None, f"{key}, which depends on it, has not been started yet"
    return fact, ""


def _facts(context: ActionContext) -> tuple[dict[str, ContainerFact], dict[str, CannotTell]]:
    """All configured containers that the engine reports now, and those about which it does not answer.

    It is asked twice about each: while it starts a container, it may be slow.
    """
    found: dict[str, ContainerFact] = {}
    unknown: dict[str, CannotTell] = {}
    keys = [entry.key for entry in context.settings.containers]
    for _ in range(2):
        unknown = {}
        for key in keys:
            try:
                fact = context.container(key)
            except CannotTell as error:
                unknown[key] = error
                continue
            if fact is not None:
                found[key] = fact
        keys = list(unknown)
    return found, unknown


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
    needs = _needs(facts, containers, network_only=network_only)
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


def _needs(
    facts: Mapping[str, ContainerFact], containers: Sequence[ContainerSettings], *, network_only: bool = False
) -> dict[str, set[str]]:
    """On which containers each one depends directly."""
    after = {entry.key: () if network_only else entry.after for entry in containers}
    return {
        key: {other for other in facts if _shares(facts.get(key), facts[other], network_only=network_only)}
        | set(after.get(key, ()))
        for key in dict.fromkeys([*after, *facts])
    }


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
