"""Topics that are listed but that PHM has never received: whether one was due, whether it fell silent before PHM's ROS process was
started, or whether the transport of its container is blocked. Pure rules, used by `rates`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phm import api
from phm_checks._quorum import ReceivedBefore
from phm_checks._ros_facts import full_name
from phm_checks._witnesses import WITNESSES, Arrivals, Causes, expected, independent


def publishers_of(seen: api.TopicFact) -> set[str]:
    """The nodes that publish the topic."""
    return {end.node for end in seen.publishers}


class UnreceivedTopics:
    """Call `observe` in each run of the check."""

    def __init__(
        self,
        topics: Sequence[api.TopicSettings],
        targets: Mapping[str, str],
        grace_s: float,
        arrivals: Mapping[str, Arrivals],
    ) -> None:
        """targets: the container of each topic, by its name; arrivals: by container."""
        self._topics, self._targets, self._grace_s = tuple(topics), dict(targets), grace_s
        self._arrivals = dict(arrivals)
        self._received = ReceivedBefore({topic.name: targets[topic.name] for topic in topics})

    def observe(self, world: api.World, fact: api.RosFact) -> None:
        """Keep which topics are received in this run of their container."""
        flowing = {name for name, seen in fact.topics.items() if _flows(seen)}
        self._received.observe(world, (one.name for one in self._topics if full_name(one.name) in flowing))

    def due(self, topic: api.TopicSettings, fact: api.RosFact) -> bool:
        """Whether PHM has listened long enough to have received a sample."""
        return bool(topic.rate) and fact.up_s >= self._grace_s and fact.listened_for_s >= 3 / (topic.rate or 1.0)

    def fell_silent(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact) -> bool:
        """Whether the topic was received in this run of its container by an earlier ROS process of PHM, and the present one, which has waited
        long enough by itself, receives its nodes: then the transport works."""
        waited = bool(topic.rate) and fact.up_s >= self._grace_s + 3 / (topic.rate or 1.0)
        nodes = publishers_of(seen)
        arrive = bool(nodes) and all(_arrives(node, fact) for node in nodes)
        return waited and arrive and self._received.never(topic.name) is False

    def blocked(self, target: str, seen: api.TopicFact, fact: api.RosFact) -> str:
        """Evidence that publishers are discovered but their data do not arrive; empty when the cause may be different."""
        nodes = publishers_of(seen)
        received = any(one.rate is not None and one.rate.silent_s is not None for one in fact.topics.values())
        if nodes == {""} and not fact.nodes and not received:
            # Node names arrive as data, publishers are found by discovery. Where other data arrive, it is a program without a ROS node.
            return "A publisher is discovered, but neither its node name nor a sample was received"
        silent = self._silent_nodes(target, fact)
        causes = Causes(fact)
        if not silent & nodes or independent(map(causes.of, silent)) < WITNESSES:
            return ""
        return f"{len(silent)} nodes are discovered, but no sample from any of them was received"

    def _silent_nodes(self, target: str, fact: api.RosFact) -> set[str]:
        """The nodes of this container whose samples are due, if none of them was received; else the empty set."""
        nodes: set[str] = set()
        for topic in self._topics:
            seen = fact.topics.get(full_name(topic.name), api.TopicFact())
            if self._targets[topic.name] != target:
                continue
            if seen.rate is not None and seen.rate.silent_s is not None:
                return set()
            if self.due(topic, fact):
                nodes |= {node for node in publishers_of(seen) if expected(node, fact)}
        received = nodes & fact.beacons.keys() or self._arrivals[target].newest_s(fact, nodes) < float("inf")
        return set() if received else nodes


def _flows(seen: api.TopicFact) -> bool:
    """Whether its samples are received, and it is not silent."""
    rate = seen.rate
    return rate is not None and not rate.problem and rate.silent_s is not None and rate.hz != 0.0


def _arrives(node: str, fact: api.RosFact) -> bool:
    """Whether PHM's ROS process has received a beacon or a topic of the node, and no other node has received it since."""
    if not node or fact.received_only_elsewhere(node):
        return False
    topics = (topic for topic in fact.topics.values() if publishers_of(topic) == {node})
    return node in fact.beacons or any(one.rate is not None and one.rate.silent_s is not None for one in topics)
