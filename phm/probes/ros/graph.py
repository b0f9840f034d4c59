"""What discovery knows: nodes by name, and the endpoints of the topics that are wanted.

Runs in the child alone. Names and counts cost microseconds and are read each tick; the endpoints, with
node names and QoS, cost 50 us a topic and are read when the middleware tells of a change, when names or counts
changed, and once a second.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from phm.facts import EndpointFact

OWN = "_phm_"
"""Hidden nodes of this prefix are PHM's own, those of a child that was just replaced included."""
_ENDLESS_NS = 2**63 - 1
"""What the middleware says for `no deadline`; 0 is `not specified`, which has none either."""
_HASH_SHOWN = 15
"""`RIHS01_` and 8 digits: enough to tell two definitions of a type apart."""
_UNKNOWN = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")


class Graph:
    """The newest view. `nodes`: full name -> how often it is listed; `publishers`, `subscribers`: by topic."""

    def __init__(self, node: Any, topics: Sequence[str], full_s: float) -> None:
        self._node = node
        self._topics = tuple(topics)
        self._full_s = full_s
        self._next_full_s = 0.0
        self._counts: tuple[int, ...] = ()
        self._unsettled = False
        self.nodes: dict[str, int] = {}
        self.publishers: dict[str, tuple[EndpointFact, ...]] = dict.fromkeys(topics, ())
        self.subscribers: dict[str, tuple[EndpointFact, ...]] = dict.fromkeys(topics, ())

    def look(self, now_s: float, *, told: bool = False) -> bool:
        """Read what may have changed; True when something did. told: the middleware says that something has."""
        nodes = self._read_nodes()
        counts = self._read_counts()
        changed = nodes != self.nodes
        if told or changed or counts != self._counts or self._unsettled or now_s >= self._next_full_s:
            self._next_full_s = now_s + self._full_s
            changed = self._read_endpoints() or changed
        self.nodes, self._counts = nodes, counts
        return changed

    def _read_nodes(self) -> dict[str, int]:
        listed = Counter(
            full_name(name, namespace)
            for name, namespace in self._node.get_node_names_and_namespaces()
            if not name.startswith(OWN)
        )
        return dict(sorted(listed.items()))

    def _read_counts(self) -> tuple[int, ...]:
        node = self._node
        return tuple(
            count(topic) for topic in self._topics for count in (node.count_publishers, node.count_subscribers)
        )

    def _read_endpoints(self) -> bool:
        publishers = self._ask(self._node.get_publishers_info_by_topic)
        subscribers = self._ask(self._node.get_subscriptions_info_by_topic)
        changed = (publishers, subscribers) != (self.publishers, self.subscribers)
        self.publishers, self.subscribers = publishers, subscribers
        # An endpoint may be known a moment before the name of its node: look again at the next tick.
        ends = (*publishers.values(), *subscribers.values())
        self._unsettled = any(not end.node for topic in ends for end in topic)
        return changed

    def _ask(self, by_topic: Callable[[str], Iterable[Any]]) -> dict[str, tuple[EndpointFact, ...]]:
        return {topic: endpoints(by_topic(topic)) for topic in self._topics}


def endpoints(infos: Iterable[Any]) -> tuple[EndpointFact, ...]:
    """rclpy's TopicEndpointInfo as facts, PHM's own left out, in a stable order."""
    facts = (_endpoint(info) for info in infos if not info.node_name.startswith(OWN))
    return tuple(sorted(facts, key=lambda fact: (fact.node, fact.type)))


def _endpoint(info: Any) -> EndpointFact:
    qos = info.qos_profile
    type_hash = str(getattr(info, "topic_type_hash", ""))  # not in Humble
    plain = EndpointFact(
        node="" if info.node_name in _UNKNOWN else full_name(info.node_name, info.node_namespace),
        type=info.topic_type,
        type_hash=type_hash[:_HASH_SHOWN] if type_hash.startswith("RIHS") else "",
    )
    if not quality_matters():
        return plain
    return replace(
        plain,
        reliability=qos.reliability.name.lower(),
        durability=qos.durability.name.lower(),
        deadline_s=_seconds(qos.deadline),
        liveliness=qos.liveliness.name.lower(),
        lease_s=_seconds(qos.liveliness_lease_duration),
    )


@functools.cache
def quality_matters() -> bool:
    """Whether this middleware refuses pairs by quality of service, as DDS does; Zenoh connects everything.

    Where it does not, endpoints are told without it, so that nobody finds a mismatch.
    """
    from rclpy.qos import QoSCompatibility, QoSProfile, QoSReliabilityPolicy, qos_check_compatible

    weak = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    strong = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.RELIABLE)
    return bool(qos_check_compatible(weak, strong)[0] == QoSCompatibility.ERROR)


def _seconds(duration: Any) -> float | None:
    nanoseconds = duration.nanoseconds
    return None if nanoseconds <= 0 or nanoseconds >= _ENDLESS_NS else nanoseconds / 1e9


def full_name(name: str, namespace: str) -> str:
    """`node_1` in `/agent_1` -> `/agent_1/node_1`."""
    return f"{namespace.rstrip('/')}/{name}"
