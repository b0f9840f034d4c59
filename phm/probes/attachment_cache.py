"""Remembers how containers were attached to their networks, so that recovery can restore that.

Once a container is disconnected, the engine forgets its aliases and its fixed address on that network.
"""

from __future__ import annotations

from collections.abc import Collection

from phm.facts import Attachment, ContainerFact, DockerProbe, OtherContainer, ProcessFact


class AttachmentCache:
    """A `phm.facts.DockerProbe` that keeps the last attachment of each container to each network.

    Bounded by the configuration: one entry per configured container and network on which it was seen.
    """

    def __init__(self, inner: DockerProbe) -> None:
        self._inner = inner
        self._seen: dict[tuple[str, str], Attachment] = {}

    def engine(self) -> str:
        return self._inner.engine()

    def container(self, name: str, young_s: float = 0.0) -> ContainerFact | None:
        fact = self._inner.container(name, young_s)
        if fact is not None and fact.running:
            for attachment in fact.networks:
                self._seen[name, attachment.name] = attachment
        return fact

    def processes(self, name: str) -> tuple[ProcessFact, ...]:
        return self._inner.processes(name)

    def own_container(self) -> ContainerFact | None:
        return self._inner.own_container()

    def others(self) -> tuple[OtherContainer, ...]:
        return self._inner.others()

    def network_id(self, name: str) -> str:
        return self._inner.network_id(name)

    def reachable(self, address: str) -> bool:
        return self._inner.reachable(address)

    def resume(self, before: AttachmentCache, containers: Collection[str]) -> None:
        """Keep what is known of these containers after a reload: one that is disconnected now is not seen attached again."""
        earlier = before._seen.copy()  # in one step: a check of the former daemon that hangs may still write
        self._seen = {place: seen for place, seen in earlier.items() if place[0] in containers} | self._seen

    def remembered(self, container: str, network: str) -> Attachment | None:
        return self._seen.get((container, network))
