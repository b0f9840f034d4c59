"""Reads the graph: nodes by name, and the endpoints of the wanted topics. Runs only in the child.

Names and counts cost microseconds and are read each tick. The endpoints, with node names and QoS, cost 50 us per topic
and are read when the middleware reports a change, when names or counts changed, and once a second.
"""

from __future__ import annotations

import contextlib
import functools
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any

from phm.facts import EndpointFact
from phm.probes.ros.name_limits import MAX_STRANGERS, Ends, kept_ends, kept_nodes
from phm.probes.ros.raw_names import printable, raw_node_names, undecodable

OWN_NODE_PREFIX = "_phm_"
"""Hidden nodes with this prefix are PHM's own, including those of a child that was just replaced."""
NOT_UTF8 = "a node or topic in the ROS domain has a name that is not UTF-8: {}"
MAX_PROBLEMS, MAX_TEXT = 5, 300
MAX_CULPRITS = 8
_ENDLESS_NS = 2**63 - 1
"""The middleware's value for `no deadline`; 0 is `not specified`, which has none either."""
_HASH_SHOWN = 15
"""`RIHS01_` and 8 digits: enough to distinguish two definitions of a type."""
_UNKNOWN = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")


class GraphReader:
    """The newest graph. `nodes`: full name -> how often it is listed; `publishers`, `subscribers`: by topic.

    names_known: whether node names could be read. problems: sentences about what could not be read, or was dropped.
    """

    def __init__(self, node: Any, topics: Sequence[str], full_s: float, configured: Collection[str] = ()) -> None:
        """configured: full names of nodes that are always kept."""
        self._node = node
        self._topics = tuple(topics)
        self._full_s = full_s
        self.configured = frozenset(configured)
        self._next_full_s = 0.0
        self._counts: tuple[int, ...] = ()
        self._unsettled = False
        self._of_names: dict[str, None] = {}
        self._of_ends: dict[str, None] = {}
        self.names_known = True
        self.nodes: dict[str, int] = {}
        self.publishers: Ends = dict.fromkeys(topics, ())
        self.subscribers: Ends = dict.fromkeys(topics, ())

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple({**self._of_names, **self._of_ends})[:MAX_PROBLEMS]

    def poll(self, now_s: float, *, notified: bool = False) -> bool:
        """Read what may have changed. Returns whether anything did. notified: the middleware reports a change."""
        before = self.problems
        nodes = self._read_nodes()
        counts = self._read_counts()
        changed = nodes != self.nodes
        self.nodes = nodes
        if notified or changed or counts != self._counts or self._unsettled or now_s >= self._next_full_s:
            self._next_full_s = now_s + self._full_s
            changed = self._read_endpoints() or changed
        self._counts = counts
        return changed or self.problems != before

    def _read_nodes(self) -> dict[str, int]:
        self._of_names = {}
        try:
            found = self._names()
        except Exception as error:  # whatever rclpy and rcl raise, rates and beacons must continue
            self.names_known = False
            self._of_names[f"node names cannot be read: {error}"[:MAX_TEXT]] = None
            return {}
        self.names_known = True
        listed = Counter(
            printable(full_name(name, namespace)) for name, namespace in found if not name.startswith(OWN_NODE_PREFIX)
        )
        nodes, left_out = kept_nodes(listed, self.configured)
        if left_out:
            self._of_names[f"the ROS domain has more than {MAX_STRANGERS} unconfigured nodes; PHM ignores the rest"] = (
                None
            )
        return nodes

    def _names(self) -> Sequence[tuple[str, str]]:
        try:
            found: Sequence[tuple[str, str]] = self._node.get_node_names_and_namespaces()
        except UnicodeDecodeError as error:
            self._of_names[NOT_UTF8.format(undecodable(error))] = None
            found = raw_node_names(self._node)
        return found

    def _read_counts(self) -> tuple[int, ...]:
        node = self._node
        return tuple(
            count(topic) for topic in self._topics for count in (node.count_publishers, node.count_subscribers)
        )

    def _read_endpoints(self) -> bool:
        self._of_ends = {}
        node = self._node
        publishers = self._ask(
            node.get_publishers_info_by_topic, node.get_publisher_names_and_types_by_node, node.count_publishers
        )
        subscribers = self._ask(
            node.get_subscriptions_info_by_topic, node.get_subscriber_names_and_types_by_node, node.count_subscribers
        )
        (publishers, subscribers), left_out = kept_ends((publishers, subscribers), self.configured)
        if left_out:
            self._of_ends["the configured topics have more publishers and subscribers than PHM can pass on"] = None
        changed = (publishers, subscribers) != (self.publishers, self.subscribers)
        self.publishers, self.subscribers = publishers, subscribers
        # An endpoint may be known a moment before the name of its node: look again at the next tick.
        ends = (*publishers.values(), *subscribers.values())
        self._unsettled = any(not end.node for topic in ends for end in topic)
        return changed

    def _ask(
        self, by_topic: Callable[[str], Iterable[Any]], by_node: Callable[[str, str], Any], count: Callable[[str], int]
    ) -> Ends:
        found = {}
        for topic in self._topics:
            try:
                found[topic] = endpoints(by_topic(topic))
            except (
                Exception
            ) as error:  # one invalid name hides all endpoints of the topic; ask for the configured nodes instead
                culprit = undecodable(error) if isinstance(error, UnicodeDecodeError) else ""
                words = (
                    NOT_UTF8.format(culprit) if culprit else f"endpoints of {topic} cannot be read: {error}"[:MAX_TEXT]
                )
                self._of_ends[words] = None
                found[topic] = self._by_node(topic, by_node, count(topic), culprit)
        return found

    def _by_node(
        self, topic: str, by_node: Callable[[str, str], Any], count: int, culprit: str
    ) -> tuple[EndpointFact, ...]:
        """Endpoints of the configured nodes, without QoS; the others have the name that causes the problem."""
        found = []
        for name in self.configured & self.nodes.keys():
            namespace, _, short = name.rpartition("/")
            types = None
            with contextlib.suppress(Exception):  # the node has left, or one of its types has an invalid name
                types = dict(by_node(short, namespace or "/")).get(topic)
            if types:
                found.append(EndpointFact(name, printable(types[0])))
        rest = min(count - len(found), MAX_CULPRITS)
        return tuple(sorted(found, key=lambda fact: fact.node)) + (EndpointFact(culprit, ""),) * rest


def endpoints(infos: Iterable[Any]) -> tuple[EndpointFact, ...]:
    """rclpy's TopicEndpointInfo as facts, without PHM's own, in a stable order."""
    facts = (_endpoint(info) for info in infos if not info.node_name.startswith(OWN_NODE_PREFIX))
    return tuple(sorted(facts, key=lambda fact: (fact.node, fact.type)))


def _endpoint(info: Any) -> EndpointFact:
    qos = info.qos_profile
    type_hash = str(getattr(info, "topic_type_hash", ""))  # not in Humble
    plain = EndpointFact(
        node=node_of(info),
        type=printable(info.topic_type),
        type_hash=type_hash[:_HASH_SHOWN] if type_hash.startswith("RIHS") else "",
    )
    strict = quality_matters()
    if not strict and info.endpoint_type.name != "PUBLISHER":
        return plain
    kept = replace(plain, reliability=qos.reliability.name.lower(), durability=qos.durability.name.lower())
    if not strict:
        return kept
    return replace(
        kept,
        deadline_s=_seconds(qos.deadline),
        liveliness=qos.liveliness.name.lower(),
        lease_s=_seconds(qos.liveliness_lease_duration),
    )


@functools.cache
def quality_matters() -> bool:
    """Whether this middleware does not connect pairs with incompatible QoS, as DDS; Zenoh connects all.

    If it connects all, subscriptions are reported without QoS, so that no mismatch is found, and publishers with the policies that
    show whether a topic is latched.
    """
    from rclpy.qos import QoSCompatibility, QoSProfile, QoSReliabilityPolicy, qos_check_compatible

    weak = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
    strong = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.RELIABLE)
    return bool(qos_check_compatible(weak, strong)[0] == QoSCompatibility.ERROR)


def _seconds(duration: Any) -> float | None:
    nanoseconds = duration.nanoseconds
    return None if nanoseconds <= 0 or nanoseconds >= _ENDLESS_NS else nanoseconds / 1e9


def node_of(info: Any) -> str:
    """The full name of an endpoint's node; empty if it has none or discovery has not delivered it yet."""
    return "" if info.node_name in _UNKNOWN else printable(full_name(info.node_name, info.node_namespace))


def full_name(name: str, namespace: str) -> str:
    """`node_1` in `/agent_1` -> `/agent_1/node_1`."""
    return f"{namespace.rstrip('/')}/{name}"
