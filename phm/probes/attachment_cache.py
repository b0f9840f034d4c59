"""Remembers how containers were attached to their networks, so that recovery can restore that.

Once a container is disconnected, the engine forgets its aliases and its fixed address on that network.
"""

from __future__ import annotations

from collections.abc import Collection

from phm.facts import Attachment, ContainerFact, DockerProbe, OtherContainer, ProcessFact


class AttachmentCache:
    """A `phm.facts.DockerProbe` that keeps the last attachment of each container, and of PHM's own, to each network.

    Bounded by the configuration: one entry per container and network on which it was seen.
    """

    def __init__(self, inner: DockerProbe) -> None:
        self._inner = inner
        self._seen: dict[tuple[str, str], Attachment] = {}
        self._own: dict[str, Attachment] = {}

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
        fact = self._inner.own_container()
        if fact is not None:
            self._own |= {attachment.name: attachment for attachment in fact.networks}
        return fact

    def others(self) -> tuple[OtherContainer, ...]:
        return self._inner.others()

    def network_id(self, name: str) -> str:
        return self._inner.network_id(name)

    def network_driver(self, name: str) -> str:
        return self._inner.network_driver(name)

    def reachable(self, address: str) -> bool:
        return self._inner.reachable(address)

    def resume(self, before: AttachmentCache, containers: Collection[str]) -> None:
        """Keep what is known of these containers after a reload: one that is disconnected now is not seen attached again."""
        earlier = before._seen.copy()  # in one step: a check of the former daemon that hangs may still write
        self._seen = {place: seen for place, seen in earlier.items() if place[0] in containers} | self._seen
        self._own = before._own | self._own

    def remembered(self, container: str, network: str) -> Attachment | None:
        return self._seen.get((container, network))

    def own_remembered(self, network: str) -> Attachment | None:
        """How PHM's own container was attached to the network."""
        return self._own.get(network)
