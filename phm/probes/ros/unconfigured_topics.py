"""Topics that are not in the configuration, with the nodes that use them, to find misspelt names.

Runs only in the child. Names cost microseconds; endpoints cost 50 us per topic and are read when their count changed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable
from typing import Any

from phm.facts.ros import CONSENSUS, NameFact
from phm.probes.ros.graph import NOT_UTF8, endpoints
from phm.probes.ros.raw_names import printable, undecodable

POLL_S = 2.0
MAX_TOPICS = 200
MAX_NAMES_BYTES = 200_000
"""Limit for the names of topics and of their nodes together, as bytes of JSON; the longest are dropped."""
MAX_NODES = 8
"""Limit for one side of one topic: a name used by many nodes is not misspelt."""
MAX_COUNTED = 2000
"""Topics whose endpoints are counted: that takes about 20 ms."""
MAX_READS = 50
"""Topics whose endpoints are read per poll; the others follow in the next one."""
CLOCK = "/clock"
"""Always kept: it shows that time is simulated, so a check that misses it takes correct stamps for wrong ones."""
REFUSED = "a participant of the ROS domain has a topic whose name ROS does not allow, so PHM leaves it out: {}"
_UNREAD = (-1, -1)
_EVERYWHERE = ("/parameter_events", "/rosout", "/phm/beacon", "/phm/hello", CONSENSUS)


class UnconfiguredTopics:
    """The newest names; `observe` returns whether they changed."""

    def __init__(self, node: Any, configured: Collection[str]) -> None:
        self._node = node
        self._left_out = frozenset((*configured, *_EVERYWHERE))
        self._next_s = 0.0
        self._counts: dict[str, tuple[int, int]] = {}
        self._facts: dict[str, NameFact] = {}
        self._read_s: dict[str, float] = {}
        self.names: dict[str, NameFact] = {}
        self.problem = ""
        """What could not be read at the last poll, as a sentence."""

    def observe(self, now_s: float) -> bool:
        """Read what has changed; at most every POLL_S."""
        if now_s < self._next_s:
            return False
        self._next_s = now_s + POLL_S
        self.problem = ""
        try:
            counts = self._read_counts()
        except UnicodeDecodeError as error:
            self.problem = NOT_UTF8.format(undecodable(error))
            return False
        changed = [name for name, count in counts.items() if count != self._counts.get(name)]
        # New topics first. Then those with other users, before those that lack a name, which may never get one. The longest unread first.
        changed.sort(key=lambda name: (self._lacks_name(name), self._read_s.get(name, -math.inf)))
        for name in changed[MAX_READS:]:
            counts[name] = self._counts.get(name, _UNREAD)
        self._facts = {name: fact for name, fact in self._facts.items() if name in counts}
        self._read_s = {name: at_s for name, at_s in self._read_s.items() if name in counts}
        for name in changed[:MAX_READS]:
            fact, self._read_s[name] = self._read(name), now_s
            if "" in (*fact.publishers, *fact.subscribers):
                counts[name] = _UNREAD  # the node's name arrives a moment after its endpoint: look again
            self._facts[name] = NameFact(_named(fact.publishers), _named(fact.subscribers))
        self._counts = counts
        before, self.names = (
            self.names,
            _fitting({name: fact for name, fact in self._facts.items() if fact != NameFact()}),
        )
        return self.names != before

    def _lacks_name(self, name: str) -> bool:
        """Whether it was read before the names of all its nodes had arrived."""
        return name in self._facts and self._counts.get(name) == _UNREAD

    def _read_counts(self) -> dict[str, tuple[int, int]]:
        node = self._node
        found = [name for name, _ in node.get_topic_names_and_types() if self._is_other(name)]
        counts = {}
        for name in sorted(found, key=lambda name: (name != CLOCK, name))[:MAX_COUNTED]:
            try:
                counts[name] = node.count_publishers(name), node.count_subscribers(name)
            except Exception:  # rclpy and pybind: a participant without ROS can announce any name, e.g. `rt/arm-state`
                self.problem = REFUSED.format(printable(name))
        # After it, topics used on one side only come first, those with subscribers before others: keep these if there are too many.
        names = sorted(counts, key=lambda name: (name != CLOCK, counts[name][0] > 0, counts[name][1] > 0, name))
        return {name: counts[name] for name in names[:MAX_TOPICS]}

    def _is_other(self, name: str) -> bool:
        return name not in self._left_out and "/_" not in name

    def _read(self, name: str) -> NameFact:
        node = self._node
        try:
            return NameFact(
                _nodes(node.get_publishers_info_by_topic(name)), _nodes(node.get_subscriptions_info_by_topic(name))
            )
        except UnicodeDecodeError as error:
            self.problem = NOT_UTF8.format(undecodable(error))
            return NameFact()


def _fitting(facts: dict[str, NameFact]) -> dict[str, NameFact]:
    """As many as fit into MAX_NAMES_BYTES, the shortest first. A character takes up to 12 bytes there."""
    sizes = {
        name: len(json.dumps(name)) + sum(len(json.dumps(node)) for node in (*fact.publishers, *fact.subscribers))
        for name, fact in facts.items()
    }
    left = MAX_NAMES_BYTES
    for name in sorted(sizes, key=lambda name: (name != CLOCK, sizes[name])):
        left -= sizes[name]
        if left < 0:
            del facts[name]
    return facts


def _named(nodes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(filter(None, nodes))


def _nodes(infos: Iterable[Any]) -> tuple[str, ...]:
    return tuple(sorted({end.node for end in endpoints(infos)}))[:MAX_NODES]
