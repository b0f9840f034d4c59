"""Slot 6: every configured ROS node is listed in the graph."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm import api
from phm.api import Layer, Slot
from phm_checks._words import brief, did_you_mean, last, span

OLD_PICTURE_S = 5.0
"""A picture of the graph older than this proves nothing."""
TWICE_S = 30.0
"""A restarted node is listed twice until its old lease ends, 20 s by default in Fast DDS; longer means two nodes."""

SETTLE_S = 0.3
"""Nodes that end in an orderly way leave the graph a moment before their container is seen to have exited."""


@dataclass(frozen=True)
class Wanted:
    """One configured node with the key of its container (empty when not known)."""

    name: str
    container: str

    @property
    def unit(self) -> str:
        return f"nodes/{api.topic_id(self.name)}"


class Nodes(api.Check):
    """All configured nodes, one unit each, from one picture of the graph."""

    name, slot, layer = "nodes", Slot.NODES, Layer.ROS
    period_s = 1.0

    def __init__(self, wanted: Sequence[Wanted], units: Sequence[api.Unit], grace_s: float) -> None:
        self._wanted = tuple(wanted)
        self._units = tuple(units)
        self._grace_s = grace_s
        self._seen: set[str] = set()
        self._listed_by_this_child: set[str] = set()
        self._child_up_s = 0.0
        self._lives: dict[str, str] = {}
        self._twice_since: dict[str, float] = {}

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        wanted = [
            Wanted(f"/{api.topic_id(node.name)}", settings.container_of_node(node.name)) for node in settings.ros.nodes
        ]
        grace_s = settings.ros.grace
        units = []
        for node in wanted:
            key = node.container
            needs = (f"container/{key}", f"network/{key}") if key else ()
            units.append(api.Unit(node.unit, needs=needs, target=key, settle_s=SETTLE_S, grace_s=grace_s))
        return [cls(wanted, units, grace_s)] if wanted else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        keys = {node.container for node in self._wanted if node.container}
        return frozenset({"ros", *(f"container:{key}" for key in keys)})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each node; STALE for all when there is no picture to judge."""
        try:
            fact = world.ros.look()
        except api.CannotTell as reason:
            return {node.unit: api.stale(str(reason)) for node in self._wanted}
        if fact.age_s > OLD_PICTURE_S:
            words = f"the newest picture of the ROS graph is {span(fact.age_s)} old, too old to judge by"
            return {node.unit: api.stale(words) for node in self._wanted}
        if fact.up_s < self._child_up_s:
            self._listed_by_this_child.clear()
        self._child_up_s = fact.up_s
        return {node.unit: self._judge(world, node, fact) for node in self._wanted}

    def _judge(self, world: api.World, node: Wanted, fact: api.RosFact) -> api.Result:
        count = fact.nodes.get(node.name, 0)
        if count:
            return self._listed(world, node, count)
        self._twice_since.pop(node.name, None)
        # A picture that once had the node and has it no more is proof, however young it is.
        if fact.up_s < self._grace_s and node.name not in self._listed_by_this_child:
            return api.stale(
                f"node {node.name} is not listed yet; PHM has looked at the graph for {span(fact.up_s)} only"
            )
        self._forget_earlier_life(world, node.container)
        seen = node.name in self._seen
        where = f" in {node.container}" if node.container else ""
        what = "is no longer running" if seen else "has not been seen since the start"
        step = "restart it and see its log" if seen else "check its launch file, name, namespace and ROS_DOMAIN_ID"
        return api.error(
            f"Not all required nodes are running. Missing node: {api.topic_id(node.name)}; it {what}{where}, expected in the "
            f"graph: {step}.{did_you_mean(node.name, self._strangers(fact))}",
            brief=brief(last(node.name), "dead" if seen else "never started"),
            condition="node_missing",
            target=node.container,
            listed=0,
        )

    def _strangers(self, fact: api.RosFact) -> list[str]:
        """Listed nodes that are not configured: only one of these can be the missing one under another name."""
        configured = {node.name for node in self._wanted}
        return [name for name in fact.nodes if name not in configured]

    def _listed(self, world: api.World, node: Wanted, count: int) -> api.Result:
        self._listed_by_this_child.add(node.name)
        if node.name not in self._seen:
            self._forget_earlier_life(world, node.container)
            self._seen.add(node.name)
        if count < 2:
            self._twice_since.pop(node.name, None)
            return api.ok(f"Node {api.topic_id(node.name)} is running", listed=count)
        now = world.clock.mono()
        since = self._twice_since.setdefault(node.name, now)
        if now - since <= TWICE_S:
            return api.ok(f"Node {api.topic_id(node.name)} is running (an earlier one is still listed)", listed=count)
        return api.warn(
            f"node {node.name} is listed {count} times for more than {TWICE_S:.0f} s, expected once: two nodes of one name "
            "disturb each other; stop one, or give each its own namespace",
            brief=brief(last(node.name), "runs twice"),
            condition="node_twice",
            listed=count,
        )

    def _forget_earlier_life(self, world: api.World, container: str) -> None:
        """What was seen before the container started says nothing about its nodes now."""
        life = self._life(world, container)
        if life and self._lives.get(container) != life:
            self._lives[container] = life
            self._seen.difference_update(node.name for node in self._wanted if node.container == container)

    @staticmethod
    def _life(world: api.World, container: str) -> str:
        """Which life of the container this is; empty when it cannot be told."""
        if not container:
            return ""
        try:
            fact = world.docker.container(container)
        except api.CannotTell:
            return ""
        return fact.life if fact is not None else ""
