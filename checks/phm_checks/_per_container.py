"""Base class of the checks of one container: one instance for each container whose configuration requires it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

from phm import api
from phm.api import Layer


class PerContainer(api.Check):
    """One instance, one unit ``<check>/<container>``, for each configured container that `wanted` accepts."""

    layer: ClassVar[Layer] = Layer.DOCKER

    def __init__(self, entry: api.ContainerSettings) -> None:
        self.entry = entry
        self.key = entry.key

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        """Whether this container's configuration gives the check something to evaluate."""
        return True

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(entry) for entry in settings.containers if cls.wanted(entry)]

    @property
    def subject(self) -> str:
        return self.key

    @property
    def unit_id(self) -> str:
        return f"{self.name}/{self.key}"

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({f"container:{self.key}"})
