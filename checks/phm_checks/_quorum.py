"""Nodes that the majority has declared dead for so long that no other check will report them. Keeps state between runs.

`nodes` reports a dead or hung node by PHM's own evidence, and first: a node that also PHM does not receive is left to it for longer
than `nodes` ever needs, so that one death raises one alarm.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm import api
from phm_checks._node_consensus import MET_S, PHM, Agreement, Opinion, Verdict
from phm_checks._ros_facts import beacon_silent

RECEIVED_S = 10.0
"""A node that PHM receives is dead if the majority has not received it for this long: a restarted node is discovered sooner."""
SILENT_S = 20.0
"""The same if PHM does not receive it either. `nodes` decides within 15 s, unless the node's process uses the CPU or is unknown."""
SETTLE_S = 5.0
"""Such a result must last this long after any grace: `nodes` has the same grace and decides then."""
YOUNG_S = 10.0
"""The run of a container needs no separate request, as its start is an event of the engine: other checks ask more often."""
ENDED_S = 5.0
"""A beacon that has been silent for this long, while the node gives other signs of life, was closed."""


@dataclass(frozen=True, slots=True)
class _Death:
    """What must stay the same for a verdict to last: another run of the node is another case."""

    node: str
    birth: str
    received: bool


class DeadNodes:
    """Since when the majority has not received which nodes (monotonic seconds)."""

    def __init__(self, nodes: Sequence[str]) -> None:
        self._nodes = nodes
        self._since: dict[_Death, float] = {}
        self._counts: Mapping[str, int] | None = None
        self._appeared: dict[str, float] = {}
        self.reported: frozenset[str] = frozenset()
        """The dead nodes of the last `observe`."""

    def clear(self) -> None:
        """Forget all verdicts: the consensus is unknown."""
        self._since, self.reported = {}, frozenset()

    def list(self, counts: Mapping[str, int], now: float) -> None:
        """Take how often the graph lists each node."""
        newest = {node: counts.get(node, 0) for node in self._nodes}
        for node, count in newest.items():
            if self._counts is not None and count > self._counts[node]:
                self._appeared[node] = now
        self._counts = newest

    def restarted(self, node: str, beacon: api.BeaconFact, now: float) -> bool:
        """Whether the node appeared in the graph after its last heartbeat: its new process has no beacon."""
        return self._appeared.get(node, float("-inf")) > now - beacon.age_s

    def observe(self, agreement: Agreement, beacons: Mapping[str, api.BeaconFact], now: float) -> Sequence[Opinion]:
        """Take a consensus; return the opinions on the nodes that are dead now."""
        dead = {
            _Death(item.node, beacons[item.node].birth, PHM in item.received_by): item
            for item in agreement.opinions
            if item.verdict is Verdict.DEAD and any(observer != PHM for observer in item.not_received_by)
        }
        self._since = {death: self._since.get(death, now) for death in dead}
        found = [
            item
            for death, item in dead.items()
            if now - self._since[death] >= (RECEIVED_S if death.received else SILENT_S)
        ]
        self.reported = frozenset(item.node for item in found)
        return found


class ReceivedBefore:
    """In which run of its container a node, or a publisher by its subscriber, was received: a restart restores only what that run had."""

    def __init__(self, containers: Mapping[Hashable, str]) -> None:
        """containers: by what is observed the container whose run counts, empty if unknown."""
        self._containers = containers
        self._runs: dict[str, tuple[str, float]] = {}
        """By container: its generation, and since when it has been seen (monotonic seconds)."""
        self._received: dict[Hashable, str] = {}
        """The generation of the container when it was received."""

    def observe(self, world: api.World, received: Iterable[Hashable]) -> None:
        """Take what is received now."""
        now = world.clock.mono()
        for container in set(filter(None, self._containers.values())):
            generation = _generation(world, container)
            if generation != self._runs.get(container, ("", 0.0))[0]:
                self._runs[container] = generation, now
        for one in received:
            generation, since = self._runs.get(self._containers.get(one, ""), ("", now))
            if generation and now - since >= MET_S:
                self._received[one] = generation

    def never(self, one: Hashable) -> bool | None:
        """Whether it has not been received in this run of its container; None: the run is unknown."""
        generation, _ = self._runs.get(self._containers.get(one, ""), ("", 0.0))
        return self._received.get(one) != generation if generation else None


def received_by_others(agreement: Agreement) -> list[str]:
    """The living nodes that another node receives."""
    alive = (item for item in agreement.opinions if item.verdict in (Verdict.ALIVE, Verdict.HUNG))
    return [item.node for item in alive if any(observer != PHM for observer in item.received_by)]


def _generation(world: api.World, container: str) -> str:
    try:
        fact = world.docker.container(container, YOUNG_S)
    except api.CannotTell:
        return ""
    return fact.generation if fact is not None else ""


def ended(beacon: api.BeaconFact, late_s: float) -> bool:
    """Whether the beacon has been silent for so long that other signs of life mean that it was closed."""
    return beacon_silent(beacon, late_s) and beacon.silent_s - late_s > ENDED_S
