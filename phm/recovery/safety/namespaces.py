"""Which containers use the namespaces of which others, by what the engine says; also containers that are not configured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, ContainerFact
from phm.recovery.actions.restart import owners
from phm.transport.docker import EngineMissing

Inspect = Callable[[str], Mapping[str, Any]]
"""The engine's data of one container, by name or id. Raises CannotTell, and EngineMissing if there is none."""
ENDED = frozenset({"created", "exited", "dead", "removing"})
"""States in which nothing of a container can be taken down."""


def described(answer: Mapping[str, Any], ref: str) -> ContainerFact:
    """Name, id and namespaces of the container that the engine means by `ref`. Raises CannotTell."""
    host = answer.get("HostConfig") or {}
    fact = ContainerFact(
        name=str(answer.get("Name") or "").lstrip("/"),
        id=str(answer.get("Id") or ""),
        status="",
        started_at="",
        network_mode=str(host.get("NetworkMode") or ""),
        pid_mode=str(host.get("PidMode") or ""),
        ipc_mode=str(host.get("IpcMode") or ""),
    )
    if not fact.id:
        raise CannotTell(f"the Docker Engine described {ref} without an id")
    return fact


class OwnerRemoved(CannotTell):
    """The container of a namespace was removed: it is not known whether that was its own or another one's."""


def with_owners(
    keys: Iterable[str],
    facts: Mapping[str, ContainerFact],
    containers: Sequence[ContainerSettings],
    inspect: Inspect,
    *,
    network_only: bool = False,
) -> dict[str, ContainerFact]:
    """`facts`, and by their ids the containers missing there on which `keys` depend, over any number of steps.

    A container that joins a namespace of one that has itself joined that of a third one uses that of the third; the one
    between them need not be configured. Raises CannotTell if that cannot be determined.
    """
    found = dict(facts)
    after = {} if network_only else {entry.key: entry.after for entry in containers}
    for key in keys:
        try:
            _add_owners(key, found, after, inspect, network_only=network_only)
        except OwnerRemoved:
            if key in facts and facts[key].status not in ENDED:
                raise
    return found


def _add_owners(
    start: str,
    found: dict[str, ContainerFact],
    after: Mapping[str, Sequence[str]],
    inspect: Inspect,
    *,
    network_only: bool,
) -> None:
    waiting, seen = [start], set[str]()
    while waiting:
        key = waiting.pop()
        if key in seen:
            continue
        seen.add(key)
        waiting += after.get(key, ())
        if key in found:
            user = found[key]
            waiting += [_owner(ref, user, found, inspect) for ref in owners(user, network_only=network_only)]


def _owner(ref: str, user: ContainerFact, found: dict[str, ContainerFact], inspect: Inspect) -> str:
    """The key in `found` of the container that the engine means by `ref`, which is added if it is missing."""
    for key, fact in found.items():
        if ref in (fact.id, fact.name):
            return key
    try:
        owner = described(inspect(ref), ref)
    except EngineMissing:
        short = ref if len(ref) < 64 else ref[:12]
        raise OwnerRemoved(f"{user.name} uses a namespace of {short}, which was removed") from None
    key = next((known for known, fact in found.items() if fact.id == owner.id), owner.id)
    found.setdefault(key, owner)
    return key
