"""All that the daemon knows from its ROS child, as one record that changes with each message."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from phm.core.scheduling_delay import Late, never_late
from phm.facts import RosFact, TopicFact
from phm.facts.ros import NameFact, RateFact
from phm.probes.ros.fact_codec import changer
from phm.probes.ros.protocol import Heard, Message, Others, Picture, Tick
from phm.probes.ros.self_reports import SelfReports

BREAK_S, AGAIN_S = 1.0, 30.0
"""A child that was so late may have lost others whose leases ended meanwhile, and finds them again. After such a break another
one counts only so much later: a permanently starved child must not hide what is missing."""
FRESH_S = 4.0
"""A silence is reported by then, or the report about its node will not decide it."""
_with_rate = changer(TopicFact, "rate")
_with_silence = changer(RateFact, "silent_s")
_with_age = changer(RateFact, "age_s")
_with_late = changer(RateFact, "not_counted_s")


def again_s(grace_s: float) -> float:
    """So long after a break another one counts at the earliest: in between there is time to prove absence twice over."""
    return max(AGAIN_S, 3.0 * grace_s)


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """Immutable, so that it can be read without a lock. seen_s: when the picture was made or confirmed, monotonic seconds."""

    picture: Picture | None = None
    seen_s: float = 0.0
    self_reports: SelfReports = field(default_factory=SelfReports)
    others: Mapping[str, NameFact] = field(default_factory=dict)
    silent_s: Mapping[str, float | None] = field(default_factory=dict)
    """Of topics with a rate, as of `seen_s`, where that is newer than the picture."""
    break_s: float = float("-inf")
    """When the child went on after it had not run for BREAK_S, monotonic seconds."""
    again_s: float = AGAIN_S
    """So much later another break counts: see `again_s`."""

    def with_message(self, message: Message, now_s: float) -> GraphSnapshot:
        picture, self_reports, others, silent_s = self.picture, self.self_reports, self.others, self.silent_s
        seen_s, break_s = self.seen_s, self.break_s
        if isinstance(message, (Picture, Tick)) and message.late_s >= BREAK_S and now_s - break_s >= self.again_s:
            break_s = now_s
        if isinstance(message, Heard):
            self_reports = self_reports.with_news(message, now_s)
        elif isinstance(message, Others):
            others = message.names
        elif isinstance(message, Picture):
            picture, silent_s, seen_s = message, {}, now_s
        elif isinstance(message, Tick) and picture is not None and message.picture == picture.number:
            picture, silent_s, seen_s = replace(picture, up_s=message.up_s), message.silent_s, now_s
        return GraphSnapshot(picture, seen_s, self_reports, others, silent_s, break_s, self.again_s)

    def without_picture(self) -> GraphSnapshot:
        """A message was lost, which may have been a picture."""
        return replace(self, picture=None, silent_s={})

    def changed_by(self, message: Message) -> bool:
        """Whether checks are to look at once: nodes, endpoints, whether topics flow, beacons, a level in the diagnostics."""
        if isinstance(message, Heard):
            return self.self_reports.differs(message)
        return isinstance(message, Picture) and (self.picture is None or _shape(self.picture) != _shape(message))

    def fact(self, picture: Picture, now_s: float, late_s: Late = never_late) -> RosFact:
        """As a fact, with ages as of `now_s`. picture: that of this view, which there must be. late_s: of the child."""
        age_s = max(0.0, now_s - self.seen_s)

        def late(passed_s: float) -> float:
            """Of this time until now: the longest pause, and where the child is starved for good half of what is left."""
            longest_s = min(passed_s, late_s(now_s - passed_s, 0.0))
            return min(passed_s, late_s(now_s - passed_s, (passed_s - longest_s) / 2)) if longest_s else 0.0

        topics = {name: self._aged(name, topic, age_s, late) for name, topic in picture.topics.items()}
        self_reports = self.self_reports.since(now_s, late)
        listened_s = picture.up_s + age_s
        up_s = min(listened_s, now_s - self.break_s)
        return RosFact(
            age_s,
            up_s,
            picture.nodes,
            topics,
            *self_reports,
            self.others,
            self.self_reports.refused,
            picture.names_known,
            None if self.self_reports.lost_at is None else now_s - self.self_reports.lost_at,
            listened_s,
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
            # Nothing has come since the picture was made: then it said how long before the look the last one was published.
            aged = _with_age(aged, rate.age_s + max(0.0, silent_s - rate.silent_s))
        fact: TopicFact = _with_rate(topic, aged)
        return fact


def flow(rate: RateFact) -> tuple[float | None, bool, str]:
    """What must not change unnoticed of a rate: whether it is silent, whether it has become another one, why it is not known.

    In the first seconds of a silence each look counts: with it comes what is known of the node meanwhile.
    """
    silent_s = None if rate.hz != 0.0 else min(rate.silent_s or 0.0, FRESH_S)
    return silent_s, rate.changed_s is not None, rate.problem


def _shape(picture: Picture) -> object:
    """What must not change unnoticed: nodes, endpoints, and how topics flow."""
    flows = {
        name: (topic.publishers, topic.subscribers, topic.rate and flow(topic.rate))
        for name, topic in picture.topics.items()
    }
    return dict(picture.nodes), flows
