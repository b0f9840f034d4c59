"""Disks as targets of recovery: `disk:PATH`. No container can be called so."""

from __future__ import annotations

from phm.core.settings import ContainerSettings

PREFIX = "disk:"


def path_of(target: str) -> str:
    """The disk's path; empty when the target is something else."""
    return target.removeprefix(PREFIX) if target.startswith(PREFIX) else ""


def as_container(target: str) -> ContainerSettings | None:
    """Recovery knows what it acts on as a container. Whether anything may be removed there is for the action to know, so
    this one has opted in. None when the target is no disk."""
    return ContainerSettings.model_construct(alias=target, recover=True) if path_of(target) else None


def by_hand(target: str) -> str:
    """What an operator can do when PHM has given up."""
    return f"make room on {path_of(target)} by hand: old logs, bags and images (`docker system df`)"
