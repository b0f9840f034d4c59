"""Evidence about one node from ROS graph snapshots, with the state that this requires."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from phm import api
from phm_checks._evidence import EvidencePiece, Kind, Observation
from phm_checks._ros_facts import beacon_silent, full_name, is_large
from phm_checks._text import last, listed, span

LATE_S = 1.5
"""An executor that has not run for this long is late. Below the time after which a silent topic is reported."""
WAVER_PERIODS = 2.0
"""A beacon or topic that is silent for this many periods is not evidence yet, but a reason to check the processes."""
WAVER_S = 0.2
OVERDUE_S = 2.0
"""For this long the last message of a slow topic counts more than a process that has ended."""
PAUSE_S = 2.75
"""PHM samples large topics with pauses of this length (`phm.probes.ros.rates.topic_monitor`), so they appear to be interrupted."""
TWICE_S = 30.0
"""A restarted node is listed twice until its old lease ends, 20 s by default in Fast DDS; longer means two nodes."""


UNNAMED_S = 20.0
"""For this long, endpoints without a node name are evidence against a node's absence: after 5 s PHM looks for the names with a new
participant (`phm.probes.ros.unnamed_participants`), which takes seconds."""


@dataclass(frozen=True, slots=True)
class NodeTopics:
    """One node's topics according to the configuration: those with a rate that only this node publishes, and all that it uses."""

    rates: tuple[tuple[str, float], ...] = ()
    """(Full topic name, rate in Hz)."""
    topics: tuple[str, ...] = ()

    @classmethod
    def of(cls, node: str, topics: Iterable[api.TopicSettings]) -> NodeTopics:
        rates, used = [], []
        for topic in topics:
            name = full_name(topic.name)
            publishers = [full_name(end) for end in topic.publishers]
            if publishers == [node] and topic.rate:
                rates.append((name, topic.rate))
            if node in publishers or node in map(full_name, topic.subscribers):
                used.append(name)
        return cls(tuple(rates), tuple(used))


class GraphEvidence:
    """One node in the graph snapshots. `suspicions` (why it may not be healthy) and `count` (how often it is listed) are those of the last
    snapshot."""

    def __init__(self, node: str, ends: NodeTopics, grace_s: float) -> None:
        self._node, self._ends, self._grace_s = node, ends, grace_s
        self._up_s = 0.0
        self._listed_by_this_child = False
        self._gone_since: float | None = None
        self._had_ends = False
        self._never_named: dict[tuple[str, str], int] = {}
        """How many endpoints had no node name while the node's own were there, by topic and side: those of programs without a ROS
        node, such as PX4's agent, never get one."""
        self._bare_since: float | None = None
        self._twice_since: float | None = None
        self.appeared_at = float("-inf")
        """When its name appeared in the graph, or appeared one more time, on the monotonic clock."""
        self.count = 0
        self.rivals = 0
        """Other processes that send beacons under its name."""
        self.duplicated = False
        """The node is listed more than once, and so is one of its endpoints. A name alone may remain in the graph permanently; this was
        observed after the node's interface had been down for seconds."""
        self.suspicions: set[str] = set()
        self.blind = True
        """The graph is the only source: the node has neither a beacon nor a topic with a rate."""

    def observe(
        self, fact: api.RosFact | None, now: float, began_at: float, *, same_process: bool = False
    ) -> list[EvidencePiece]:
        """Evidence from the newest snapshot; None if there is none. began_at: older data belongs to an earlier node of this name, and so
        does data from before its name appeared, unless its process is known to be the same."""
        if fact is None:
            self.suspicions, self.blind = {"no snapshot"}, True
            return []
        if fact.up_s < self._up_s:
            self._listed_by_this_child = False
        self._up_s = fact.up_s
        self.suspicions = set()
        name = self._name(fact, now)
        self._count_ends(fact, now)
        beacon = self._beacon(fact, now, began_at if same_process else max(began_at, self.appeared_at))
        topics = self._topics(fact)
        self.blind = beacon is None and topics is None
        return [piece for piece in (beacon, topics, self._endpoints(fact, now), name) if piece is not None]

    def twice(self, now: float) -> bool:
        """Whether the node runs twice: listed so for longer than any lease, or while another process sends beacons under its name."""
        return self._twice_since is not None and (now - self._twice_since > TWICE_S or self.rivals > 0)

    # ------------------------------------------------------------ one method per kind

    def _beacon(self, fact: api.RosFact, now: float, began_at: float) -> EvidencePiece | None:
        beacon = fact.beacons.get(self._node)
        self.rivals = beacon.rivals if beacon is not None else 0
        if beacon is None or now - beacon.age_s < began_at:
            return None
        if self.rivals:
            self.suspicions.add("rivals")
        # While PHM's own child process is late, nothing is received from any node: that does not count as silence.
        silent_s = max(0.0, beacon.silent_s - fact.age_s)
        if silent_s > WAVER_PERIODS * beacon.period_s:
            self.suspicions.add("beacon irregular")
        if beacon_silent(beacon, fact.age_s):
            self.suspicions.add("beacon silent")
            if (report := fact.received_only_elsewhere(self._node)) is not None:
                return _as_others_receive_it(report)
            words = f"its beacon has been silent for {span(silent_s)}"
            return EvidencePiece(Kind.BEACON, Observation.SILENT, words, fact.age_s, silent_s)
        overdue = silent_s > WAVER_PERIODS * beacon.period_s
        if beacon.turns and beacon.late_s > LATE_S:
            self.suspicions.add("executor late")
            words = f"its executor has been blocked for {span(beacon.late_s)}, according to its beacon"
            return EvidencePiece(Kind.BEACON, Observation.LATE, words, beacon.age_s, beacon.late_s, overdue=overdue)
        words = f"its last beacon was {span(beacon.age_s)} ago"
        return EvidencePiece(Kind.BEACON, Observation.ALIVE, words, beacon.age_s, overdue=overdue)

    def _topics(self, fact: api.RosFact) -> EvidencePiece | None:
        """Topics that only this node publishes: data on one is a sign of life, silence of all a reason to check the processes."""
        silent: list[tuple[float, str]] = []
        limits = []
        for topic, rate_hz in self._ends.rates:
            seen = fact.topics.get(topic)
            rate = seen.rate if seen is not None else None
            if seen is None or rate is None or rate.silent_s is None or rate.problem:
                continue
            if any(end.node not in ("", self._node) for end in seen.publishers):
                continue
            known_s = max(0.0, rate.silent_s - rate.not_counted_s - fact.age_s)
            if known_s <= _waver_s(rate, rate_hz):
                words, overdue = f"data arrives on {last(topic)}", known_s > OVERDUE_S
                return EvidencePiece(Kind.TOPICS, Observation.ALIVE, words, rate.silent_s, overdue=overdue)
            silent.append((known_s, topic))
            limits.append(rate.limit_s or 3.0 / rate_hz)
        if not silent:
            return None
        shortest_s = min(silent)[0]
        overdue = shortest_s > max(limits)
        self.suspicions |= {"topics irregular", "topics silent"} if overdue else {"topics irregular"}
        words = f"silent for {span(shortest_s)}: {listed([last(topic) for _, topic in silent], 3)}"
        return EvidencePiece(Kind.TOPICS, Observation.SILENT, words, fact.age_s, shortest_s, overdue=overdue)

    def _endpoints(self, fact: api.RosFact, now: float) -> EvidencePiece | None:
        """Missing endpoints count only for a listed node that had some: otherwise its topics are remapped, or it is still starting."""
        seen = (fact.topics.get(topic, api.TopicFact()) for topic in self._ends.topics)
        if any(end.node == self._node for topic in seen for end in (*topic.publishers, *topic.subscribers)):
            self._had_ends, self._bare_since = True, None
            self._never_named = self._nameless(fact)
            return EvidencePiece(Kind.ENDPOINTS, Observation.ALIVE, "its endpoints are there", fact.age_s)
        if not self.count or not self._had_ends:
            self._had_ends, self._bare_since = False, None
            return None
        if self._unnamed(fact):
            return None
        self._bare_since = now if self._bare_since is None else self._bare_since
        self.suspicions.add("no endpoints")
        lasted_s = now - self._bare_since
        words = "none of its endpoints is in the graph"
        return EvidencePiece(Kind.ENDPOINTS, Observation.GONE, words, fact.age_s, lasted_s)

    def _count_ends(self, fact: api.RosFact, now: float) -> None:
        self.duplicated = self.count > 1 and self._most_ends(fact) != 1
        self._twice_since = (self._twice_since or now) if self.duplicated else None

    def _most_ends(self, fact: api.RosFact) -> int:
        """The highest number of times that one endpoint of a topic is listed for this node; 0 if none of its endpoints is listed."""
        seen = [fact.topics.get(topic, api.TopicFact()) for topic in self._ends.topics]
        ends = ([end.node for end in side] for one in seen for side in (one.publishers, one.subscribers))
        return max((nodes.count(self._node) for nodes in ends), default=0)

    def _name(self, fact: api.RosFact, now: float) -> EvidencePiece | None:
        """If the child process has never listed the node, its snapshots prove the node's absence only once it has run for long enough."""
        count = fact.nodes.get(self._node, 0)
        if count > self.count:
            self.appeared_at = now
            self.suspicions.add("listed again")
        self.count = count
        if count > 1:
            self.suspicions.add("listed twice")
        if count:
            self._listed_by_this_child, self._gone_since = True, None
            return EvidencePiece(Kind.NAME, Observation.ALIVE, "it is listed in the graph", fact.age_s)
        self.suspicions.add("not listed")
        if not fact.names_known:
            return None
        if fact.up_s < self._grace_s and not self._listed_by_this_child:
            self._gone_since = None
            return None
        self._gone_since = now if self._gone_since is None else self._gone_since
        if self._listed_by_this_child and now - self._gone_since < UNNAMED_S and self._unnamed(fact):
            self.suspicions.add("name unknown")
            return None
        return EvidencePiece(Kind.NAME, Observation.GONE, "it is not in the graph", fact.age_s, now - self._gone_since)

    def _unnamed(self, fact: api.RosFact) -> bool:
        """Whether an endpoint of its topics has lost its node name: it may be this node's own, whose name only PHM has lost."""
        return any(count > self._never_named.get(side, 0) for side, count in self._nameless(fact).items())

    def _nameless(self, fact: api.RosFact) -> dict[tuple[str, str], int]:
        """How many endpoints of its topics have no node name, by topic and side."""
        seen = {topic: fact.topics.get(topic, api.TopicFact()) for topic in self._ends.topics}
        sides = {(name, "out"): topic.publishers for name, topic in seen.items()}
        sides |= {(name, "in"): topic.subscribers for name, topic in seen.items()}
        return {side: sum(not end.node for end in ends) for side, ends in sides.items()}


def _as_others_receive_it(report: api.Reception) -> EvidencePiece:
    """A node that another one has received since its last beacon here is not silent: PHM's own participant is at fault."""
    words = f"PHM does not receive its beacon, but {report.by} does"
    if report.late_s > LATE_S:
        words += f"; its executor has been blocked for {span(report.late_s)}"
        return EvidencePiece(Kind.BEACON, Observation.LATE, words, report.ago_s, report.late_s)
    return EvidencePiece(Kind.BEACON, Observation.ALIVE, words, report.ago_s)


def _waver_s(rate: api.RateFact, expected_hz: float) -> float:
    pause_s = PAUSE_S if is_large(rate, rate.hz or expected_hz) else 0.0
    return max(WAVER_PERIODS / expected_hz, WAVER_S) + pause_s
