"""Whether discovery between PHM and a container passes and no data does: several nodes at once, of which nothing is heard. Pure but
for asking the world.

One node that says nothing may hang. That all nodes of a container fall silent in the same moment, while discovery lists them and
their processes run, is the way between them and PHM: a firewall, or a transport that is not shared.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm import api
from phm_checks._matching import Wanted, match
from phm_checks._signs import Ends
from phm_checks._words import listed, span

WITNESSES = 2
SILENT_S = 3.0
"""Well below the time after which the silence of a single node is told, so that this is known before."""
TOGETHER_S = 1.5
"""Beacons beat five times a second and topics of 1 Hz once: so far apart may be the last signs of nodes cut off at once."""
OLD_PICTURE_S = 2.0


class Deaf:
    """What may be heard of one container's nodes: beacons, and topics with a rate that one node alone publishes."""

    def __init__(self, key: str, settings: api.Settings) -> None:
        self._key, self._grace_s = key, settings.ros.grace
        names = [f"/{api.topic_id(node.name)}" for node in settings.ros.nodes]
        words = {f"/{api.topic_id(node.name)}": tuple(node.process) for node in settings.ros.nodes}
        own = [name for name in names if settings.container_of_node(name) == key]
        self._wanted = [Wanted(name, key, words[name]) for name in own]
        self._ends = {name: Ends.of(name, settings.ros.topics) for name in own}
        self._life, self._met_at = "", 0.0
        self._deaf_life = ""
        """In which it was blocked last, until something was heard in another."""
        self.never_heard = False
        """Of the last answer that said why: whether nothing was ever heard in this life."""

    def why(self, world: api.World, life: str) -> str:
        """The evidence in words; empty while anything is heard, or when it cannot be told. life: of the container, now."""
        why = self._why(world, life)
        if why:
            self._deaf_life = life
        return why

    def waiting(self, world: api.World, life: str) -> bool:
        """It was blocked in the life before, and whether data come in this one is not known yet. After `why`."""
        if self._deaf_life in ("", life):
            return False
        now = world.clock.mono()
        if now - self._met_at > 2 * self._grace_s or self._heard(world, now):
            self._deaf_life = ""
        return bool(self._deaf_life)

    def _heard(self, world: api.World, now: float) -> bool:
        """Whether any node has given a sign in this life."""
        try:
            fact = world.ros.look()
        except api.CannotTell:
            return False
        ages = (self._silent_s(node, fact) for node in self._wanted)
        return any(age is not None and now - age > self._met_at for age in ages)

    def _why(self, world: api.World, life: str) -> str:
        if len(self._wanted) < WITNESSES:
            return ""
        now = world.clock.mono()
        if life != self._life:
            self._life, self._met_at = life, now
        try:
            fact = world.ros.look()
        except api.CannotTell:
            return ""
        if fact.age_s > OLD_PICTURE_S:
            return ""
        silent = [found for node in self._wanted if (found := self._silent_s(node, fact)) is not None]
        # What was heard before this life was heard of other processes, whose names may be listed until their lease ends.
        if len(silent) >= WITNESSES and _together(silent) and now - max(silent) > self._met_at and self._run(world):
            self.never_heard = False
            return (
                f"nothing has come of any of its {len(silent)} nodes for {span(min(silent))}, though discovery lists them and "
                "their processes run"
            )
        if not silent and now - self._met_at > self._grace_s and self._nameless(fact) and self._run(world):
            self.never_heard = True
            return (
                f"publishers are found, and neither names of their nodes nor a sample has come for {span(fact.up_s)}, though "
                f"the processes of {listed([node.short for node in self._wanted], 3)} run"
            )
        return ""

    def _silent_s(self, node: Wanted, fact: api.RosFact) -> float | None:
        """Since the last sign of a node that is listed; None: it is not, or it never gave one, so it is no witness."""
        if not fact.nodes.get(node.name):
            return None
        ages = list(self._signs(node, fact))
        return max(0.0, min(ages) - fact.age_s) if ages else None

    def _signs(self, node: Wanted, fact: api.RosFact) -> Iterable[float]:
        beacon = fact.beacons.get(node.name)
        if beacon is not None:
            yield beacon.age_s
        for topic, _ in self._ends[node.name].rates:
            rate = fact.topics.get(topic, api.TopicFact()).rate
            if rate is not None and rate.silent_s is not None:
                yield rate.silent_s

    def _nameless(self, fact: api.RosFact) -> bool:
        """Nodes' names come as data, that there are publishers with discovery."""
        if fact.up_s < self._grace_s or any(node.name in fact.nodes for node in self._wanted):
            return False
        topics = [fact.topics.get(topic, api.TopicFact()) for ends in self._ends.values() for topic, _ in ends.rates]
        found = [end.node for topic in topics for end in topic.publishers]
        heard = any(topic.rate is not None and topic.rate.silent_s is not None for topic in topics)
        return len(found) >= WITNESSES and not any(found) and not heard

    def _run(self, world: api.World) -> bool:
        """Whether each node has a process of its own, none of them stopped. Asked only when there is a reason."""
        try:
            found, _ = match(self._wanted, world.docker.processes(self._key), {})
        except api.CannotTell:
            return False
        states = [one.process.state[:1] for one in found.values()]
        return len(states) == len(self._wanted) and not any(state in ("T", "t") for state in states)


def _together(silent: Sequence[float]) -> bool:
    return min(silent) > SILENT_S and max(silent) - min(silent) <= TOGETHER_S
