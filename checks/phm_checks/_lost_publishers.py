"""Publishers that a running subscriber has lost, as its beacon reports. Keeps state between runs.

After an overload, two participants of DDS can stay without each other for good, while each of them and PHM receive all others. Then
the data between them does not arrive, although no node is dead and PHM receives every topic.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm import api
from phm_checks._node_consensus import receives_other
from phm_checks._ros_facts import beacon_silent, full_name

LOST_S = 10.0
"""Participants that can find each other again do so sooner: they announce themselves every 3 s or more often."""
SETTLE_S = 10.0
"""The result must last this long after any starvation and any grace."""


@dataclass(frozen=True, slots=True)
class Connection:
    """A configured topic between two configured nodes, by full names."""

    publisher: str
    subscriber: str
    topic: str


def connections(settings: api.Settings, nodes: Sequence[str]) -> tuple[Connection, ...]:
    """The configured ones between two of `nodes`; one for each pair of nodes and direction."""
    found: dict[tuple[str, str], Connection] = {}
    for topic in settings.ros.topics:
        for publisher in map(full_name, topic.publishers):
            for subscriber in map(full_name, topic.subscribers):
                if publisher != subscriber and {publisher, subscriber} <= set(nodes):
                    found.setdefault((publisher, subscriber), Connection(publisher, subscriber, topic.name))
    return tuple(found.values())


class LostPublishers:
    """Since when which subscribers have not received their publishers (monotonic seconds)."""

    def __init__(self, connections: Iterable[Connection]) -> None:
        self._connections = tuple(connections)
        self._since: dict[tuple[Connection, str, str], float] = {}
        self.received: tuple[Connection, ...] = ()
        """The connections whose subscriber received its publisher at the last `observe`."""

    def clear(self) -> None:
        """Forget them: the beacons are unknown."""
        self._since, self.received = {}, ()

    def observe(self, beacons: Mapping[str, api.BeaconFact], late_s: float, now: float) -> list[Connection]:
        """The connections that are lost now. late_s: age of the snapshot of `beacons`."""
        reports = {one: _received(one, beacons, late_s) for one in self._connections}
        self.received = tuple(one for one, received in reports.items() if received)
        lost = {
            (one, beacons[one.publisher].birth, beacons[one.subscriber].birth): one
            for one, received in reports.items()
            if received is False
        }
        self._since = {run: self._since.get(run, now) for run in lost}
        return [one for run, one in lost.items() if now - self._since[run] >= LOST_S]


def _received(one: Connection, beacons: Mapping[str, api.BeaconFact], late_s: float) -> bool | None:
    """Whether the subscriber receives the publisher, as its beacon says. None: one of them has none now, or they are one process."""
    publisher, subscriber = beacons.get(one.publisher), beacons.get(one.subscriber)
    if publisher is None or subscriber is None or beacon_silent(publisher, late_s) or beacon_silent(subscriber, late_s):
        return None
    if publisher.witness and publisher.witness == subscriber.witness:
        return None
    return receives_other(subscriber, publisher, one.publisher)
