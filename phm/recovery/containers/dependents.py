"""Which containers depend on another: by a namespace of it, or by `after` in the configuration. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phm.core.settings import ContainerSettings
from phm.facts import ContainerFact


def dependents(
    target: str,
    facts: Mapping[str, ContainerFact],
    containers: Sequence[ContainerSettings],
    *,
    network_only: bool = False,
) -> list[str]:
    """Keys of the configured containers to be restarted after the container `target`, in order, including dependents of
    dependents.

    A container depends on another if it uses its network namespace, which is new after each start, or its PID
    namespace, whose processes end with the first one, or names it in `after`. One that depends on several comes after
    the last of them. network_only: only by the network namespace.
    """
    needs = {
        entry.key: {other for other in facts if _shares(facts.get(entry.key), facts[other], network_only=network_only)}
        | (set() if network_only else set(entry.after))
        for entry in containers
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


def _shares(fact: ContainerFact | None, owner: ContainerFact, *, network_only: bool) -> bool:
    """Whether `fact` uses a namespace of `owner`."""
    if fact is None:
        return False
    return _names(fact.network_mode, owner) or (not network_only and _names(fact.pid_mode, owner))


def _names(mode: str, owner: ContainerFact) -> bool:
    """Whether `container:REF` means `owner`; the engine keeps the user's text, id or name."""
    kind, _, ref = mode.partition(":")
    return kind == "container" and bool(ref) and (ref == owner.name or owner.id.startswith(ref))
