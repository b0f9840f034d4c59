"""Slot 7: each configured topic has its publishers and subscribers, of the right type, and they fit together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from phm import api
from phm.api import Layer, Slot
from phm_checks._words import brief, clean, did_you_mean, joined, last, listed, span

OLD_PICTURE_S = 5.0
"""A picture of the graph older than this proves nothing."""


def full(name: str) -> str:
    """A ROS name with its first slash."""
    return f"/{api.topic_id(name)}"


class Topics(api.Check):
    """The connections of all configured topics, one unit each, from one picture of the graph."""

    name, slot, layer = "topics", Slot.TOPICS, Layer.ROS
    period_s = 1.0

    def __init__(self, topics: Sequence[api.TopicSettings], units: Sequence[api.Unit], grace_s: float) -> None:
        self._topics = tuple(topics)
        self._units = tuple(units)
        self._targets = {unit.id: unit.target for unit in units}
        self._grace_s = grace_s

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        topics = settings.ros.topics
        units = []
        for topic in topics:
            key = settings.container_of_topic(topic)
            nodes = dict.fromkeys(api.topic_id(node) for node in (*topic.publishers, *topic.subscribers))
            needs = [*(f"container/{key}", f"network/{key}")] if key else []
            needs += [f"nodes/{node}" for node in nodes]
            units.append(
                api.Unit(_unit(topic), needs=tuple(needs), target=key, settle_s=1.5, grace_s=settings.ros.grace)
            )
        return [cls(topics, units, settings.ros.grace)] if topics else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return self._units

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros"})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each topic; STALE for all when there is no picture to judge."""
        try:
            fact = world.ros.look()
        except api.CannotTell as reason:
            return {_unit(topic): api.stale(str(reason)) for topic in self._topics}
        if fact.age_s > OLD_PICTURE_S:
            words = f"the newest picture of the ROS graph is {span(fact.age_s)} old, too old to judge by"
            return {_unit(topic): api.stale(words) for topic in self._topics}
        return {_unit(topic): self._judge(topic, fact) for topic in self._topics}

    def _judge(self, topic: api.TopicSettings, fact: api.RosFact) -> api.Result:
        seen = fact.topics.get(full(topic.name), api.TopicFact())
        missing = self._missing(topic, seen, fact)
        if missing is not None:
            if fact.up_s < self._grace_s:
                return api.stale(
                    f"not seen yet, PHM has looked at the graph for {span(fact.up_s)} only: {missing.summary}"
                )
            return missing
        problem = self._type(topic, seen) or self._qos(topic, seen)
        if problem is not None:
            return problem
        return api.ok(
            f"Topic {api.topic_id(topic.name)} is connected: {_count(seen.publishers, 'publisher')}, "
            f"{_count(seen.subscribers, 'subscriber')}",
            **_numbers(seen),
        )

    def _missing(self, topic: api.TopicSettings, seen: api.TopicFact, fact: api.RosFact) -> api.Result | None:
        """The first of: no such topic, a publisher is missing, a subscriber is missing."""
        name, values = full(topic.name), _numbers(seen)
        if not seen.publishers and not seen.subscribers:
            return api.error(
                f"topic {name} does not exist, expected a publisher: check that its node runs and how it is remapped."
                f"{did_you_mean(name, fact.topics)}",
                brief=brief(last(name), "missing"),
                condition="topic_missing",
                target=self._targets[_unit(topic)],
                **values,
            )
        for kind, wanted, there in (
            ("publisher", topic.publishers, seen.publishers),
            ("subscriber", topic.subscribers, seen.subscribers),
        ):
            names = {end.node for end in there}
            lacking = [full(node) for node in wanted if full(node) not in names]
            if lacking:
                return api.error(
                    f"topic {name} lacks its {kind} {listed(lacking)}; there is {listed(sorted(names))}: check that node's "
                    f"topic names and remappings.{did_you_mean(lacking[0], names)}",
                    brief=brief(last(name), f"lost {kind} {last(lacking[0])}"[:30]),
                    condition=f"{kind}_missing",
                    target=self._targets[_unit(topic)],
                    **values,
                )
        if not seen.publishers:
            return api.error(
                f"topic {name} has no publisher, expected one: check that its node runs and how it is remapped",
                brief=brief(last(name), "has no publisher"),
                condition="publisher_missing",
                target=self._targets[_unit(topic)],
                **values,
            )
        return None

    def _type(self, topic: api.TopicSettings, seen: api.TopicFact) -> api.Result | None:
        """ERROR for a type other than the configured one; WARN when the ends differ among themselves."""
        name, ends = full(topic.name), (*seen.publishers, *seen.subscribers)
        if topic.type is not None:
            wrong = [end for end in ends if end.type and end.type != topic.type]
            if wrong:
                return api.error(
                    f"topic {name} has type {clean(wrong[0].type, 80)} at {clean(wrong[0].node, 80)}, expected {topic.type}: "
                    "the ends do not connect; build them against the same message package",
                    brief=brief(last(name), "wrong type"),
                    condition="type_wrong",
                    target=self._targets[_unit(topic)],
                    **_numbers(seen),
                )
            return None
        types = dict.fromkeys(end.type for end in ends if end.type)
        if len(types) < 2:
            return None
        return api.warn(
            f"topic {name} is used with different types, {listed(types)}: ends of different type do not connect",
            brief=brief(last(name), "mixed types"),
            condition="type_wrong",
            target=self._targets[_unit(topic)],
            **_numbers(seen),
        )

    def _qos(self, topic: api.TopicSettings, seen: api.TopicFact) -> api.Result | None:
        """WARN for each pair whose quality-of-service offers less than is asked, so that DDS does not connect it."""
        found = [words for out in seen.publishers for into in seen.subscribers for words in _unfit(out, into)]
        if not found:
            return None
        shown = joined(found[:3]) + (f" And {len(found) - 3} more pairs." if len(found) > 3 else "")
        return api.warn(
            f"topic {full(topic.name)} does not connect all its ends. {shown} Set both ends to the same policy",
            brief=brief(last(topic.name), "QoS mismatch"),
            condition="qos_mismatch",
            target=self._targets[_unit(topic)],
            **_numbers(seen),
        )


def _unfit(out: api.EndpointFact, into: api.EndpointFact) -> list[str]:
    """Why this publisher does not serve this subscriber, by the two policies that differ most often."""
    found = []
    for policy, weak, strong in (
        ("reliability", "best_effort", "reliable"),
        ("durability", "volatile", "transient_local"),
    ):
        if _plain(getattr(out, policy)) == weak and _plain(getattr(into, policy)) == strong:
            found.append(
                f"{policy}: publisher {clean(out.node, 80)} offers {weak}, subscriber {clean(into.node, 80)} asks for {strong}"
            )
    return found


def _plain(policy: str) -> str:
    return policy.lower().replace("-", "_").replace(" ", "_")


def _unit(topic: api.TopicSettings) -> str:
    return f"topics/{api.topic_id(topic.name)}"


def _count(ends: Sequence[api.EndpointFact], what: str) -> str:
    return f"{len(ends)} {what}" if len(ends) == 1 else f"{len(ends)} {what}s"


def _numbers(seen: api.TopicFact) -> dict[str, api.Value]:
    return {"publishers": len(seen.publishers), "subscribers": len(seen.subscribers)}
