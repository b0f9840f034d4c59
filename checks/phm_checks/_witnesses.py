"""Whether the silence of several nodes shows that their data do not arrive: what disproves it, and which of them may have one cause. Pure.

Used by `network` and `rates`.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable

from phm import api
from phm_checks._process_matching import wanted_nodes
from phm_checks._ros_facts import full_name
from phm_checks._status_publisher import status_publisher

WITNESSES = 2
"""When this many nodes of one container, and all of them, are silent, and none of them may be the cause of another one's silence, the
cause is the path: they do not idle together."""
ANSWERS_S = 1.0
"""A service answers if PHM has waited no longer than this for its newest answer: PHM calls it once in one or two seconds."""
FLOWS_S = 1.0
"""An input that was received within this time is not the cause of a silence."""
CLOCK = "/clock"


class Arrivals:
    """What PHM receives from the nodes of one container, beside their beacons."""

    def __init__(self, container: str, settings: api.Settings) -> None:
        self._settings = settings
        self._nodes = frozenset(node.name for node in wanted_nodes(settings) if node.container == container)
        homes = [entry.ready for entry in settings.containers if entry.key == container]
        homes += [entry.ready for entry in settings.ros.nodes if full_name(entry.name) in self._nodes]
        self._calls = frozenset(full_name(ready.call) for ready in homes if ready is not None and ready.call)

    def newest_s(self, fact: api.RosFact, others: Collection[str] = ()) -> float:
        """Seconds since the newest of them, without the delay of the snapshot; infinite if there is none. others: more nodes of the
        container."""
        nodes = self._nodes.union(others)
        answers = [answer for name, answer in fact.lifecycle.items() if name in nodes]
        answers += [answer for service, answer in fact.calls.items() if service in self._calls]
        if any(one.served and one.answer and one.unanswered_s <= ANSWERS_S for one in answers):
            return 0.0
        ages = [
            topic.rate.silent_s - topic.rate.not_counted_s
            for topic in fact.topics.values()
            if topic.publishers and all(end.node in nodes for end in topic.publishers)
            if topic.rate is not None and topic.rate.silent_s is not None
        ]
        ages += [
            status.age_s - status.not_counted_s
            for name, status in fact.diagnostics.items()
            # A name that several publishers use may be that of another agent's node.
            if name not in fact.diagnostic_sources and status_publisher(name, self._settings) in nodes
        ]
        return max(0.0, min(ages, default=float("inf")) - fact.age_s)


def expected(node: str, fact: api.RosFact) -> bool:
    """Whether data of the node are expected: a lifecycle node publishes while it is active."""
    known = fact.lifecycle.get(node)
    return known is None or known.answer in ("", "active")


class Causes:
    """What may have silenced each node, by one snapshot: itself, and all that it waits for, directly or through other nodes. A node may
    publish once per input."""

    def __init__(self, fact: api.RosFact) -> None:
        self._waits_for: dict[str, set[str]] = {}
        users = [(name, topic.publishers, topic.subscribers) for name, topic in fact.others.items()]
        for name, topic in fact.topics.items():
            rate = topic.rate
            if rate is None or not rate.hz or rate.silent_s is None or rate.silent_s > FLOWS_S:
                users.append((name, _nodes(topic.publishers), _nodes(topic.subscribers)))
        for name, publishers, subscribers in users:
            for node in subscribers:
                self._waits_for.setdefault(node, set()).update((name, *publishers))
        # While it has a publisher, each timer may be one of simulated time.
        self._clock = {CLOCK} if any(name == CLOCK and publishers for name, publishers, _ in users) else set()

    def of(self, node: str) -> set[str]:
        """Names of nodes and topics."""
        found, new = {node, *self._clock}, [node]
        while new:
            more = self._waits_for.get(new.pop(), set()) - found
            found |= more
            new += more
        return found


def independent(causes: Iterable[Collection[Hashable]]) -> int:
    """How many nodes, of which these are the possible causes of silence, cannot have fallen silent by a common one."""
    taken: set[Hashable] = set()
    count = 0
    for each in sorted(causes, key=len):
        if taken.isdisjoint(each):
            taken.update(each)
            count += 1
    return count


def _nodes(ends: Iterable[api.EndpointFact]) -> tuple[str, ...]:
    return tuple(end.node for end in ends)
