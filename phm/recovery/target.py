"""What recovery acts on: a configured container, a disk, or one of PHM's MAVLink endpoints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

from phm.core.settings import ContainerSettings


class TargetKind(str, Enum):
    """The kind of a target; disks and links are named with it as a prefix, e.g. ``disk:/data``."""

    CONTAINER = "container"
    DISK = "disk"
    LINK = "link"


@dataclass(frozen=True, slots=True)
class Target:
    """One target of recovery.

    key:       the container's key in the configuration, the disk's path, or the endpoint's name.
    opted_in:  whether the configuration allows actions on it: `recover: true` of a container. A disk always has: an action
               removes only files that the configuration names. A link never has: only actions on PHM itself apply to it.
    container: the container's settings; None for other kinds and for a container that is not configured.
    """

    kind: TargetKind
    key: str
    opted_in: bool = False
    container: ContainerSettings | None = None

    @classmethod
    def parse(cls, name: str, containers: Iterable[ContainerSettings]) -> Target:
        """The target that a result names (`Result.target`). containers: those of the configuration."""
        for kind in (TargetKind.DISK, TargetKind.LINK):
            key = name.removeprefix(f"{kind.value}:")
            if key and key != name:
                return cls(kind, key, opted_in=kind is TargetKind.DISK)
        container = next((entry for entry in containers if entry.key == name), None)
        return cls.of(container) if container is not None else cls(TargetKind.CONTAINER, name)

    @classmethod
    def of(cls, container: ContainerSettings) -> Target:
        """The target that is a configured container."""
        return cls(TargetKind.CONTAINER, container.key, container.recover, container)

    @property
    def name(self) -> str:
        """As in `Result.target`, events and logs: a container's key, ``disk:PATH`` or ``link:NAME``."""
        return self.key if self.kind is TargetKind.CONTAINER else f"{self.kind.value}:{self.key}"

    @property
    def configured(self) -> bool:
        """False for a container that is not in the configuration."""
        return self.kind is not TargetKind.CONTAINER or self.container is not None

    def manual_step(self) -> str:
        """What an operator can do after PHM has given up."""
        if self.kind is TargetKind.DISK:
            return f"free space on {self.key} manually: old logs, bags and images (`docker system df`)"
        if self.kind is TargetKind.LINK:
            return f"check the device behind {self.key}: power, cable, settings"
        name = self.container.name if self.container is not None and self.container.name else self.key
        return f"check it manually: docker logs --tail 50 {name}"
