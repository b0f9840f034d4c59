"""MAVLink endpoints as targets of recovery: `link:NAME`. No container can be called so."""

from __future__ import annotations

from phm.core.settings import ContainerSettings

PREFIX = "link:"


def name_of(target: str) -> str:
    """The endpoint's name; empty when the target is a container."""
    return target.removeprefix(PREFIX) if target.startswith(PREFIX) else ""


def as_container(target: str) -> ContainerSettings | None:
    """Recovery knows what it acts on as a container: one that has not opted in to anything, so that only actions on what is
    PHM's own are carried out. None when the target is no endpoint."""
    return ContainerSettings.model_construct(alias=target) if name_of(target) else None


def by_hand(target: str, container: str | None) -> str:
    """What an operator can do when PHM has given up. container: its name in the engine."""
    link = name_of(target)
    if link:
        return f"look at what is behind {link} by hand: its power, its cable, its settings"
    return f"look at it by hand: docker logs --tail 50 {container or target}"
