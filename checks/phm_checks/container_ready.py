"""Slot 2: each container with `ready` has the services and topics that its users need."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from phm import api
from phm.api import Layer, Slot
from phm_checks._readiness import Requirements, Subject
from phm_checks._ros_facts import snapshot

REMEDY = "Check the log of the container"


class ContainerReady(api.Check):
    """All containers with `ready`, one unit each. They need the container's nodes: a dead node is one fault."""

    name, slot, layer = "container_ready", Slot.CONTAINER, Layer.DOCKER
    period_s = 1.0

    def __init__(self, settings: api.Settings) -> None:
        self._settings = settings
        self._subjects = [
            Subject(f"{self.name}/{entry.key}", f"container {entry.key}", entry.ready, entry.key)
            for entry in settings.containers
            if entry.ready is not None
        ]

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if any(entry.ready is not None for entry in settings.containers) else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return [one.as_unit(self._needs(one.container), self._settings) for one in self._subjects]

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each container; STALE for all without recent data from the ROS child process."""
        try:
            required = Requirements(snapshot(world), self._settings.ros)
        except api.CannotTell as reason:
            return {one.unit: api.stale(str(reason)) for one in self._subjects}
        return {one.unit: one.result(required.unmet(one.ready), REMEDY) for one in self._subjects}

    def _needs(self, container: str) -> Iterable[str]:
        nodes = (api.topic_id(node.name) for node in self._settings.ros.nodes)
        inside = [node for node in nodes if self._settings.container_of_node(node) == container]
        return (f"health/{container}", *(f"{check}/{node}" for node in inside for check in ("nodes", "node_ready")))
