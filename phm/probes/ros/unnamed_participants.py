"""Topics and nodes whose names PHM's participant has lost although others still know them. Pure; callers pass the time.

When the lease of a node ends only for PHM, as on an overloaded machine, Fast DDS drops the node. With its next
announcement the endpoints return. The names do not: they are data of a topic (`ros_discovery_info`) whose writer
considers PHM's reader as served and sends nothing again (measured with Jazzy and Kilted). A new participant receives
all names.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

from phm.facts.ros import TopicFact
from phm.probes.ros.renewal_pace import RenewalPace

UNNAMED_S = 5.0
"""An endpoint is listed some milliseconds before the name of its node; on an overloaded machine seconds."""
FLOWS_S = 1.0
TRIES = 3
"""New participants for one topic that has lost its names: the first may come while the machine is still overloaded. Endpoints
of programs without a ROS node, such as PX4's uXRCE-DDS agent, never get a name."""


class UnnamedParticipants:
    """Decides for which topics and nodes a new participant is needed."""

    def __init__(self, unnamed_s: float = UNNAMED_S) -> None:
        self._unnamed_s = unnamed_s
        self._named: set[str] = set()
        """Topics whose endpoints all had names at the last poll, or before they lost them."""
        self._since: dict[str, float] = {}
        self._complete_since: dict[str, float] = {}
        self._steady: set[str] = set()
        """Topics whose endpoints all had names for a while."""
        self._tries: dict[str, int] = {}
        """New participants for each topic since all its names were known for a while."""
        self._pace = RenewalPace()
        """Any participant can create endpoints without a name."""

    def observe(self, topics: Mapping[str, TopicFact], now: float, unlisted: Collection[str] = ()) -> tuple[str, ...]:
        """Names of topics and nodes. topics: of the newest graph. now: monotonic seconds. unlisted: nodes that send
        beacons and are not listed."""
        for name in [name for name in self._since if name not in topics and name not in unlisted]:
            del self._since[name]
        for name in unlisted:
            self._since.setdefault(name, now)
        for name, topic in topics.items():
            complete = _complete(topic)
            if complete and (topic.publishers or topic.subscribers):
                self._note_complete(name, now)
            else:
                self._complete_since.pop(name, None)
            if complete or self._tries.get(name, 0) >= self._most_tries(name, topic):
                self._since.pop(name, None)
            else:
                self._since.setdefault(name, now)
        due = tuple(sorted(name for name, at in self._since.items() if now - at >= self._unnamed_s))
        if not due or not self._pace.allows(now):
            return ()
        for name in self._since.keys() - set(unlisted):
            self._tries[name] = self._tries.get(name, 0) + 1
        self._since.clear()
        return due

    def _note_complete(self, name: str, now: float) -> None:
        """A new participant that has discovered only some of the endpoints does not count: the others may have no name again."""
        self._named.add(name)
        if now - self._complete_since.setdefault(name, now) >= self._unnamed_s:
            self._steady.add(name)
            self._tries.pop(name, None)

    def _most_tries(self, name: str, topic: TopicFact) -> int:
        if name in self._steady:
            return TRIES
        return 1 if name in self._named or _flows(topic) else 0


def _complete(topic: TopicFact) -> bool:
    """Whether all nodes that use the topic are listed by name."""
    if any(not end.node for end in (*topic.publishers, *topic.subscribers)):
        return False
    return bool(topic.publishers) or not _flows(topic)


def _flows(topic: TopicFact) -> bool:
    rate = topic.rate
    return rate is not None and bool(rate.hz) and rate.silent_s is not None and rate.silent_s <= FLOWS_S
