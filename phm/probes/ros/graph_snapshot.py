"""The state that the daemon received from its ROS child process, as one immutable record, replaced by each message."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from phm.core.scheduling_delay import Late, never_late
from phm.facts import RosFact, TopicFact
from phm.facts.ros import DataFact, NameFact, RateFact
from phm.probes.ros.fact_codec import changer
from phm.probes.ros.protocol import GraphMessage, Message, OtherTopics, ReadinessUpdate, SelfReportUpdate, Tick
from phm.probes.ros.self_reports import SelfReports

BREAK_S, AGAIN_S = 1.0, 30.0
"""A child delayed by BREAK_S may have lost participants whose leases ended meanwhile, and rediscovers them. The next break
counts only AGAIN_S later: a permanently starved child must not hide missing nodes."""
FRESH_S = 4.0
"""A silence is reported within this time, or the state of its node does not affect it."""
_with_rate = changer(TopicFact, "rate")
_with_silence = changer(RateFact, "silent_s")
_with_age = changer(RateFact, "age_s")
_with_late = changer(RateFact, "not_counted_s")


def again_s(grace_s: float) -> float:
    """Minimum time between two breaks that count: enough to prove twice that a node is missing."""
    return max(AGAIN_S, 3.0 * grace_s)


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """Immutable, so readable without a lock. seen_s: when the graph was received or confirmed, in monotonic seconds."""

    graph: GraphMessage | None = None
    seen_s: float = 0.0
    self_reports: SelfReports = field(default_factory=SelfReports)
    others: Mapping[str, NameFact] = field(default_factory=dict)
    silent_s: Mapping[str, float | None] = field(default_factory=dict)
    """Silence of topics with a rate as of `seen_s`, where newer than the graph."""
    break_s: float = float("-inf")
    """When the child resumed after a break of BREAK_S, in monotonic seconds."""
    again_s: float = AGAIN_S
    """See the function `again_s`."""
    readiness: ReadinessUpdate = field(default_factory=ReadinessUpdate)

    def with_message(self, message: Message, now_s: float) -> GraphSnapshot:
        graph, self_reports, others, silent_s = self.graph, self.self_reports, self.others, self.silent_s
        seen_s, break_s = self.seen_s, self.break_s
        if isinstance(message, (GraphMessage, Tick)) and message.late_s >= BREAK_S and now_s - break_s >= self.again_s:
            break_s = now_s
        if isinstance(message, ReadinessUpdate):
            return replace(self, readiness=message)
        if isinstance(message, SelfReportUpdate):
            self_reports = self_reports.with_update(message, now_s)
        elif isinstance(message, OtherTopics):
            others = message.names
        elif isinstance(message, GraphMessage):
            graph, silent_s, seen_s = message, {}, now_s
        elif isinstance(message, Tick) and graph is not None and message.number == graph.number:
            graph, silent_s, seen_s = replace(graph, up_s=message.up_s), message.silent_s, now_s
        return GraphSnapshot(graph, seen_s, self_reports, others, silent_s, break_s, self.again_s, self.readiness)

    def without_graph(self) -> GraphSnapshot:
        """The record after a lost message, which may have contained a graph."""
        return replace(self, graph=None, silent_s={})

    def changed_by(self, message: Message) -> bool:
        """Whether checks must run immediately: changed nodes, endpoints, flow of topics, beacons, diagnostic levels, or
        readiness."""
        if isinstance(message, ReadinessUpdate):
            return _states(message) != _states(self.readiness)
        if isinstance(message, SelfReportUpdate):
            return self.self_reports.differs(message)
        return isinstance(message, GraphMessage) and (self.graph is None or _shape(self.graph) != _shape(message))

    def fact(self, graph: GraphMessage, now_s: float, late_s: Late = never_late) -> RosFact:
        """The fact, with ages as of `now_s`. graph: the graph of this record, not None. late_s: delays of the child."""
        age_s = max(0.0, now_s - self.seen_s)

        def late(passed_s: float) -> float:
            """The part of this time in which the child did not run: the longest pause, and half of the rest if starved."""
            longest_s = min(passed_s, late_s(now_s - passed_s, 0.0))
            return min(passed_s, late_s(now_s - passed_s, (passed_s - longest_s) / 2)) if longest_s else 0.0

        topics = {name: self._aged(name, topic, age_s, late) for name, topic in graph.topics.items()}
        self_reports = self.self_reports.since(now_s, late)
        listened_s = graph.up_s + age_s
        up_s = min(listened_s, now_s - self.break_s)
        return RosFact(
            age_s,
            up_s,
            graph.nodes,
            topics,
            *self_reports,
            self.others,
            self.self_reports.refused,
            graph.names_known,
            None if self.self_reports.lost_at is None else now_s - self.self_reports.lost_at,
            listened_s,
            self.readiness.services,
            self.readiness.lifecycle,
            self.readiness.calls,
            self.self_reports.same_named(now_s, late),
        )

    def _aged(self, name: str, topic: TopicFact, age_s: float, late: Callable[[float], float]) -> TopicFact:
        rate = topic.rate
        if rate is None:
            return topic
        silent_s = self.silent_s.get(name, rate.silent_s)
        if silent_s is None:
            return topic
        silent_s += age_s
        aged: RateFact = _with_silence(rate, silent_s)
        if not_counted_s := late(silent_s):
            aged = _with_late(aged, not_counted_s)
        if rate.hz == 0.0 and rate.age_s is not None and rate.silent_s is not None:
            # No sample since the graph message, which contained the age of the last sample.
            aged = _with_age(aged, rate.age_s + max(0.0, silent_s - rate.silent_s))
        fact: TopicFact = _with_rate(topic, aged)
        return fact


def flow(rate: RateFact) -> tuple[float | None, bool, str]:
    """The properties of a rate whose change wakes checks: silent or not, changed or not, why it is unknown.

    In the first seconds of a silence every poll wakes them: the evidence about the node arrives with it.
    """
    silent_s = None if rate.hz != 0.0 else min(rate.silent_s or 0.0, FRESH_S)
    return silent_s, rate.changed_s is not None, rate.problem


def findings(data: DataFact | None) -> tuple[tuple[str, ...], tuple[str, ...], str]:
    """The properties of examined messages whose change wakes checks."""
    return ((), (), "") if data is None else (data.conditions, data.undecided, data.problem)


def _states(readiness: ReadinessUpdate) -> object:
    answers = (*readiness.lifecycle.items(), *readiness.calls.items())
    return readiness.services, [(name, fact.answer, fact.served) for name, fact in answers]


def _shape(graph: GraphMessage) -> object:
    """The properties whose change wakes checks: nodes, endpoints, and the flow of topics."""
    flows = {
        name: (topic.publishers, topic.subscribers, topic.rate and flow(topic.rate), findings(topic.data))
        for name, topic in graph.topics.items()
    }
    return dict(graph.nodes), flows
