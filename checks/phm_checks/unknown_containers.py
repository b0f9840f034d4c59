"""Slot 2: containers that run on this engine and are not in the configuration, if `docker.unknown_containers` asks for it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm import api
from phm.api import Slot
from phm_checks._unexpected import matches, unexpected

SETTLE_S = 2.0
"""`docker run --rm` for a moment, and the temporary names that Compose uses, are not reported."""


class UnknownContainers(api.Check):
    """Running containers that are not in the configuration, as one unit. PHM takes no action on them."""

    name, slot, layer = "unknown_containers", Slot.CONTAINER, api.Layer.DOCKER
    period_s = 10.0
    """The engine's events wake the check; the period is for events that were lost."""

    def __init__(self, settings: api.Settings) -> None:
        self._wanted = settings.docker.unknown_containers

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if settings.docker.unknown_containers.level != "off" else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.name, needs=("engine",), settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"engine", "other_container"})

    def run(self, world: api.World) -> api.Result:
        found = [other for other in world.docker.others() if not matches(other.name, self._wanted.ignore)]
        return unexpected(
            [(other.name, other.image) for other in found],
            level=self._wanted.level,
            noun="container",
            does="runs",
            condition="container_unknown",
            remedy="stop them (`docker ps`), or add them to `containers` or docker.unknown_containers.ignore",
        )
