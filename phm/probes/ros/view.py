"""All that the daemon knows from its ROS child, as one record that changes with each message."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from phm.facts import RosFact, TopicFact
from phm.probes.ros.hearsay import Hearsay
from phm.probes.ros.protocol import Heard, Message, Others, Picture, Tick
from phm.ros_facts import NameFact


@dataclass(frozen=True, slots=True)
class View:
    """Immutable, so that it can be read without a lock. heard_s: of the newest message, monotonic seconds."""

    picture: Picture | None = None
    heard_s: float = 0.0
    hearsay: Hearsay = field(default_factory=Hearsay)
    others: Mapping[str, NameFact] = field(default_factory=dict)

    def with_message(self, message: Message, now_s: float) -> View:
        view = replace(self, heard_s=now_s)
        if isinstance(message, Heard):
            return replace(view, hearsay=self.hearsay.with_news(message, now_s))
        if isinstance(message, Others):
            return replace(view, others=message.names)
        if isinstance(message, Picture):
            return replace(view, picture=message)
        if isinstance(message, Tick) and self.picture is not None:
            topics = {name: _silent(topic, message.silent_s.get(name)) for name, topic in self.picture.topics.items()}
            return replace(view, picture=Picture(message.up_s, self.picture.nodes, topics))
        return view

    def changed_by(self, message: Message) -> bool:
        """Whether checks are to look at once: nodes, endpoints, whether topics flow, beacons, a level in the diagnostics."""
        if isinstance(message, Heard):
            return self.hearsay.differs(message)
        return isinstance(message, Picture) and (self.picture is None or _shape(self.picture) != _shape(message))

    def fact(self, picture: Picture, now_s: float) -> RosFact:
        """As a fact, with ages as of `now_s`. picture: that of this view, which there must be."""
        age_s = max(0.0, now_s - self.heard_s)
        topics = {name: _older(topic, age_s) for name, topic in picture.topics.items()}
        hearsay = self.hearsay.since(now_s)
        return RosFact(age_s, picture.up_s + age_s, picture.nodes, topics, *hearsay, self.others, self.hearsay.refused)


def _older(topic: TopicFact, age_s: float) -> TopicFact:
    rate = topic.rate
    if rate is None or rate.silent_s is None:
        return topic
    return replace(topic, rate=replace(rate, silent_s=rate.silent_s + age_s))


def _silent(topic: TopicFact, silent_s: float | None) -> TopicFact:
    return topic if topic.rate is None else replace(topic, rate=replace(topic.rate, silent_s=silent_s))


def _shape(picture: Picture) -> object:
    """What must not change unnoticed: nodes, endpoints, and whether topics flow."""
    flows = {
        name: (topic.publishers, topic.subscribers, topic.rate and (topic.rate.hz == 0.0, topic.rate.problem))
        for name, topic in picture.topics.items()
    }
    return dict(picture.nodes), flows
