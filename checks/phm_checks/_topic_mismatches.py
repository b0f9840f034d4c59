"""Mismatches between the existing endpoints of a topic: different types, types of different content, QoS that does not fit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from phm import api
from phm.api import Level
from phm_checks._endpoint_matching import (
    Matching,
    Pairs,
    all_ends,
    needed_end,
    same_definition,
    same_type,
    sides,
    some,
    who,
)
from phm_checks._ros_facts import full_name
from phm_checks._text import clean, joined
from phm_checks._topic_results import problem, unit_id


class TopicMismatches:
    """Finds them for all topics, again only after the endpoints of a topic have changed: there may be many pairs."""

    def __init__(self, targets: Mapping[str, str], homes: Mapping[str, str]) -> None:
        """targets: the container of each unit; homes: that of each named node, by the node's full name."""
        self._targets, self._homes = targets, homes
        self._known: dict[str, tuple[object, Sequence[api.Result]]] = {}

    def find(self, topic: api.TopicSettings, seen: api.TopicFact) -> Sequence[api.Result]:
        ends = (seen.publishers, seen.subscribers)
        known = self._known.get(topic.name)
        if known is not None and known[0] == ends:
            return known[1]
        matching = Matching(topic, seen)
        results = [find(topic, seen, matching) for find in (self._type, self._definition, self._qos)]
        # Observed directly: no missing endpoint and no late node can cause them.
        conclusive = api.Evidence(conclusive=True)
        found = [result.with_evidence(conclusive) for result in results if result is not None]
        self._known[topic.name] = (ends, found)
        return found

    def _type(self, topic: api.TopicSettings, seen: api.TopicFact, matching: Matching) -> api.Result | None:
        """ERROR if a configured endpoint has the wrong type or a configured pair has different types; WARN for others."""
        name = full_name(topic.name)
        if topic.type is None:
            types = dict.fromkeys(end.type for _, end in all_ends(seen) if end.type)
            if len(types) < 2:
                return None
            differing = [pairs for pairs in matching.pairs if not same_type(*pairs.first)]
            ends = [f"{clean(end.type, 80)} at {side} {who(end)}" for side, end in sides(differing) or all_ends(seen)]
            return problem(
                topic,
                seen,
                matching.level_of(differing),
                "type_wrong",
                "mixed types",
                f"topic {name} is used with different types, and endpoints of different types do not connect: {some(ends)}; "
                "build them against the same message package",
                self._target(topic),
            )
        wrong = [(side, end) for side, end in all_ends(seen) if end.type and end.type != topic.type]
        if not wrong:
            return None
        bad = any(needed_end(topic, seen, side, end) for side, end in wrong)
        ends = [f"type {clean(end.type, 80)} at {side} {who(end)}" for side, end in wrong]
        return problem(
            topic,
            seen,
            Level.ERROR if bad else Level.WARN,
            "type_wrong",
            "wrong type",
            f"topic {name} has {some(ends)}; expected {topic.type} at all endpoints, others do not connect: build them "
            "against the same message package",
            self._target(topic),
        )

    def _definition(self, topic: api.TopicSettings, seen: api.TopicFact, matching: Matching) -> api.Result | None:
        """Types with the same name and different content: they connect, but messages are wrong or cannot be decoded."""
        found = [pairs for pairs in matching.pairs if same_type(*pairs.first) and not same_definition(*pairs.first)]
        if not found:
            return None
        ends = [f"{side} {who(end)} has {clean(end.type_hash, 20)}" for side, end in sides(found)]
        return problem(
            topic,
            seen,
            matching.level_of(found),
            "type_wrong",
            "type versions differ",
            f"topic {full_name(topic.name)}: {clean(found[0].publishers[0].type, 80)} is not the same type everywhere. {some(ends)}; build all "
            "endpoints against the same version of its package",
            self._target(topic),
        )

    def _qos(self, topic: api.TopicSettings, seen: api.TopicFact, matching: Matching) -> api.Result | None:
        """Pairs whose publisher offers less than its subscriber requests, so that DDS does not connect them."""
        found = [pairs for pairs in matching.pairs if pairs.wrong]
        if not found:
            return None
        needed = [*filter(None, map(matching.needed, found))]
        words = matching.mismatch_texts(needed or found)
        others = sum(pairs.mismatches for pairs in needed or found) - len(words)
        return problem(
            topic,
            seen,
            Level.ERROR if needed else Level.WARN,
            "qos_mismatch",
            "QoS mismatch",
            f"topic {full_name(topic.name)} does not connect all its endpoints. {joined(words)}"
            + (f" And {others} more." if others else ""),
            self._home(topic, needed),
        )

    def _home(self, topic: api.TopicSettings, found: Iterable[Pairs]) -> str:
        """The topic's container if it contains all endpoints of the pairs; empty when the cause may be elsewhere."""
        default = self._target(topic)
        homes = {self._homes.get(end.node, default) for _, end in sides(found)}
        return default if homes <= {default} else ""

    def _target(self, topic: api.TopicSettings) -> str:
        return self._targets[unit_id(topic)]
