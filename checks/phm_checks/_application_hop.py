"""The application's hop of the command path: the nodes that pass commands on, or the container in which they must be."""

from __future__ import annotations

from collections.abc import Sequence

from phm import api
from phm_checks._command_path import Hop, HopState
from phm_checks._ros_facts import OLD_SNAPSHOT_S, full_name
from phm_checks._text import last, listed, span

NAME = "application"
HANG_S = 5.0
POLL_S = 5.0
"""While its nodes are there, the engine is asked about the container this often; its own check reports it sooner."""


class ApplicationHop:
    """`nodes[].commands` name the nodes. Without them the container is inferred (`Settings.command_container`), or where no container
    may be it, the nodes without one: the only node is the hop; of several nodes, PHM does not know which one passes commands on, so
    only all of them together are.
    """

    def __init__(self, settings: api.Settings) -> None:
        self._grace_s = settings.ros.grace
        self._all = not any(node.commands for node in settings.ros.nodes)
        self.container = settings.command_container if self._all else ""
        self._nodes = [full_name(name) for name in settings.command_nodes]
        self.unclear = settings.command_path_unclear
        self._asked_at = float("-inf")
        self._fact: api.ContainerFact | None = None

    @property
    def exists(self) -> bool:
        return bool(self.container or self._nodes)

    @property
    def needs(self) -> Sequence[str]:
        """Units that, when they are bad, break the path."""
        certain = not self._all or len(self._nodes) == 1
        return (
            *((f"container/{self.container}",) if self.container else ()),
            *(f"nodes/{api.topic_id(node)}" for node in self._nodes if certain),
        )

    def evaluate(self, world: api.World) -> Hop:
        """The hop, from the graph, the beacons and the engine."""
        nodes = self._nodes_hop(world) if self._nodes else Hop(NAME, HopState.OK)
        stopped = self._stopped(world, doubt=nodes.state is not HopState.OK) if self.container else None
        return stopped or nodes

    def _stopped(self, world: api.World, *, doubt: bool) -> Hop | None:
        """The hop if the container does not run, or if that is unknown."""
        now = world.clock.mono()
        if doubt or now - self._asked_at >= POLL_S or self._fact is None or not self._fact.running:
            self._asked_at = now
            try:
                self._fact = world.docker.container(self.container)
            except api.CannotTell:
                self._fact = None
                return Hop(NAME, HopState.UNKNOWN, "the Docker Engine does not answer")
        if self._fact is None:
            return Hop(NAME, HopState.BROKEN, f"{self.container} does not exist")
        return None if self._fact.running else Hop(NAME, HopState.BROKEN, f"{self.container} is {self._fact.status}")

    def _nodes_hop(self, world: api.World) -> Hop:
        """Other faults of the nodes are reported by the check `nodes`."""
        try:
            fact = world.ros.snapshot()
        except api.CannotTell:
            return Hop(NAME, HopState.UNKNOWN, "the ROS graph is unknown")
        if fact.age_s > OLD_SNAPSHOT_S:
            return Hop(NAME, HopState.UNKNOWN, f"the ROS graph snapshot is {span(fact.age_s)} old")
        gone = [node for node in self._nodes if not fact.nodes.get(node)]
        stuck = [node for node in self._nodes if node not in gone and _stuck(node, fact)]
        if not gone and not stuck:
            return Hop(NAME, HopState.OK)
        words = f"{_named(gone)} not in the graph" if gone else f"{_named(stuck)} does not answer"
        if self._all and len(gone) + len(stuck) < len(self._nodes):
            return Hop(NAME, HopState.WEAK, words)
        known = bool(stuck) or fact.up_s > self._grace_s
        return Hop(NAME, HopState.BROKEN if known else HopState.UNKNOWN, words)


def _stuck(node: str, fact: api.RosFact) -> bool:
    beacon = fact.beacons.get(node)
    return beacon is not None and max(beacon.late_s, beacon.silent_s - fact.age_s) > HANG_S


def _named(nodes: Sequence[str]) -> str:
    return listed(map(last, nodes), 3)
