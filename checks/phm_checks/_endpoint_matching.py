"""The endpoints of one topic and their pairs: which endpoints match, and which pairs the configuration requires.

A pair is a publisher and a subscription of the same topic. Not a check: pure rules, used by `topics`.

Any participant of the ROS domain may announce any number of endpoints, and the pairs are the product of both sides. So what holds
for one pair is found once for all pairs whose endpoints differ in their nodes alone.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from phm import api
from phm.api import Level
from phm_checks._qos import Mismatch, mismatches
from phm_checks._ros_facts import full_name
from phm_checks._text import clean

SHOWN = 3
MAX_KINDS = 50
"""Limit for different types and QoS on one side of a topic, those of named nodes first: only hostile ones are more."""


def all_ends(seen: api.TopicFact) -> Iterator[tuple[str, api.EndpointFact]]:
    yield from (("publisher", end) for end in seen.publishers)
    yield from (("subscriber", end) for end in seen.subscribers)


def named_sides(
    topic: api.TopicSettings, seen: api.TopicFact
) -> tuple[tuple[str, Sequence[str], Sequence[api.EndpointFact]], ...]:
    """Kind of endpoint, the nodes that the configuration names, and the endpoints that exist."""
    return (
        ("publisher", topic.publishers, seen.publishers),
        ("subscriber", topic.subscribers, seen.subscribers),
    )


@dataclass(frozen=True)
class Pairs:
    """Each of these publishers with each of these subscriptions; those of one side differ in their nodes alone."""

    publishers: Sequence[api.EndpointFact]
    subscribers: Sequence[api.EndpointFact]
    wrong: Sequence[Mismatch]
    """Why the publishers do not serve the subscriptions although their types are the same; empty for different types."""

    @property
    def first(self) -> tuple[api.EndpointFact, api.EndpointFact]:
        return self.publishers[0], self.subscribers[0]

    @property
    def mismatches(self) -> int:
        """The number of mismatches of all pairs."""
        return len(self.publishers) * len(self.subscribers) * len(self.wrong)


class Matching:
    """All pairs of a topic, and which of them the configuration requires."""

    def __init__(self, topic: api.TopicSettings, seen: api.TopicFact) -> None:
        self._publishers, self._subscribers = (
            frozenset(map(full_name, nodes)) for nodes in (topic.publishers, topic.subscribers)
        )
        outs = _alike(seen.publishers, self._publishers)
        intos = _alike(seen.subscribers, self._subscribers)[:MAX_KINDS]
        self.pairs = [_pairs(out, into) for out in outs[:MAX_KINDS] for into in intos]
        serving = [pairs for pairs in self.pairs if same_type(*pairs.first) and not pairs.wrong]
        self._serving = {_kind(pairs.publishers[0]) for pairs in serving}
        self._served = {_kind(pairs.subscribers[0]) for pairs in serving}
        # Publishers beyond the limit may serve a named subscription, too: invented ones must not make it look unserved.
        named = [ends[0] for ends in intos if ends[0].node in self._subscribers]
        self._served |= {_kind(into) for into in named if any(serves(out[0], into) for out in outs[MAX_KINDS:])}

    def needed(self, pairs: Pairs) -> Pairs | None:
        """The pairs that the configuration requires: both endpoints are named, or the subscriber is named and no publisher serves it."""
        outs, intos = pairs.publishers, _named(pairs.subscribers, self._subscribers)
        if self._publishers:
            outs = _named(outs, self._publishers)
        elif _kind(pairs.subscribers[0]) in self._served:
            return None
        return replace(pairs, publishers=outs, subscribers=intos) if outs and intos else None

    def level_of(self, found: Iterable[Pairs]) -> Level:
        """Of a mismatch: ERROR if the configuration requires any of these pairs."""
        return Level.ERROR if any(map(self.needed, found)) else Level.WARN

    def mismatch_texts(self, found: Iterable[Pairs]) -> list[str]:
        """Of the first mismatches: there may be millions."""
        every = (
            self._mismatch_text(out, into, mismatch)
            for pairs in found
            for out in pairs.publishers
            for into in pairs.subscribers
            for mismatch in pairs.wrong
        )
        return list(islice(every, SHOWN))

    def _mismatch_text(self, out: api.EndpointFact, into: api.EndpointFact, mismatch: Mismatch) -> str:
        """Text for one policy of one pair and what to change: at the endpoint that matches no other, if there is one."""
        at_publisher = f"{mismatch.raise_offer} at the publisher"
        at_subscriber = f"{mismatch.lower_ask} at the subscriber"
        if _kind(out) in self._serving:
            change = at_subscriber
        elif _kind(into) in self._served:
            change = at_publisher
        else:
            change = f"{at_publisher}, or {at_subscriber}"
        return (
            f"{mismatch.policy}: publisher {who(out)} offers {mismatch.offered}, subscriber {who(into)} requests "
            f"{mismatch.asked}; set {change}"
        )


def sides(found: Iterable[Pairs]) -> list[tuple[str, api.EndpointFact]]:
    """The endpoints of these pairs, each once, with both sides of the first pair in front: only some are shown."""
    ends: dict[tuple[str, api.EndpointFact], None] = {}
    for pairs in found:
        first, *others = [("publisher", out) for out in pairs.publishers]
        ends |= dict.fromkeys([first, *(("subscriber", into) for into in pairs.subscribers), *others])
    return list(ends)


def _alike(ends: Iterable[api.EndpointFact], nodes: Collection[str]) -> list[list[api.EndpointFact]]:
    """The endpoints by kind, those of these nodes first."""
    kinds: dict[api.EndpointFact, list[api.EndpointFact]] = {}
    for end in sorted(ends, key=lambda end: end.node not in nodes):
        kinds.setdefault(_kind(end), []).append(end)
    return list(kinds.values())


def _kind(end: api.EndpointFact) -> api.EndpointFact:
    """All that decides which endpoints it matches."""
    return replace(end, node="")


def _pairs(outs: Sequence[api.EndpointFact], intos: Sequence[api.EndpointFact]) -> Pairs:
    out, into = outs[0], intos[0]
    return Pairs(outs, intos, mismatches(out, into) if same_type(out, into) else [])


def _named(ends: Sequence[api.EndpointFact], nodes: Collection[str]) -> list[api.EndpointFact]:
    return [end for end in ends if end.node in nodes]


def same_type(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return not (out.type and into.type) or out.type == into.type


def same_definition(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return not (out.type_hash and into.type_hash) or out.type_hash == into.type_hash


def serves(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return same_type(out, into) and not mismatches(out, into)


def needed_end(topic: api.TopicSettings, seen: api.TopicFact, side: str, end: api.EndpointFact) -> bool:
    """Whether the configuration names this endpoint, or it is the only candidate for the one required publisher."""
    if side == "subscriber":
        return named(end, topic.subscribers)
    if topic.publishers:
        return named(end, topic.publishers)
    return not any(other.type == topic.type for other in seen.publishers)


def named(end: api.EndpointFact, nodes: Iterable[str]) -> bool:
    return end.node in {full_name(node) for node in nodes}


def who(end: api.EndpointFact) -> str:
    return clean(end.node, 80) or "(unnamed node)"


def some(texts: Sequence[str]) -> str:
    shown = ", ".join(texts[:SHOWN])
    return shown if len(texts) <= SHOWN else f"{shown} and {len(texts) - SHOWN} more"
