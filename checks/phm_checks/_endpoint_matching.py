"""The endpoints of one topic and their pairs: which endpoints match, and which pairs the configuration requires.

A pair is a publisher and a subscription of the same topic. Not a check: pure rules, used by `topics`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from phm import api
from phm.api import Level
from phm_checks._qos import Mismatch, mismatches
from phm_checks._text import clean

Pair = tuple[api.EndpointFact, api.EndpointFact]
SHOWN = 3


def full(name: str) -> str:
    """A ROS name with its leading slash."""
    return f"/{api.topic_id(name)}"


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


def sides(pairs: Sequence[Pair]) -> list[tuple[str, api.EndpointFact]]:
    """The endpoints of these pairs, each once."""
    return list(
        dict.fromkeys(side for out, into in pairs for side in (("publisher", out), ("subscriber", into))),
    )


def pairs_of(seen: api.TopicFact) -> list[Pair]:
    return [(out, into) for out in seen.publishers for into in seen.subscribers]


def same_type(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return not (out.type and into.type) or out.type == into.type


def same_definition(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return not (out.type_hash and into.type_hash) or out.type_hash == into.type_hash


def serves(out: api.EndpointFact, into: api.EndpointFact) -> bool:
    return same_type(out, into) and not mismatches(out, into)


def needed(topic: api.TopicSettings, seen: api.TopicFact, pair: Pair) -> bool:
    """Whether the configuration requires this pair: both endpoints are named, or the subscriber is named and no publisher serves it."""
    out, into = pair
    if not named(into, topic.subscribers):
        return False
    if topic.publishers:
        return named(out, topic.publishers)
    return not any(serves(other, into) for other in seen.publishers)


def needed_end(topic: api.TopicSettings, seen: api.TopicFact, side: str, end: api.EndpointFact) -> bool:
    """Whether the configuration names this endpoint, or it is the only candidate for the one required publisher."""
    if side == "subscriber":
        return named(end, topic.subscribers)
    if topic.publishers:
        return named(end, topic.publishers)
    return not any(other.type == topic.type for other in seen.publishers)


def named(end: api.EndpointFact, nodes: Iterable[str]) -> bool:
    return end.node in {full(node) for node in nodes}


def level_of(topic: api.TopicSettings, seen: api.TopicFact, pairs: Sequence[Pair]) -> Level:
    return Level.ERROR if any(needed(topic, seen, pair) for pair in pairs) else Level.WARN


def mismatch_text(seen: api.TopicFact, pair: Pair, mismatch: Mismatch) -> str:
    """Text for one policy of one pair and what to change: at the endpoint that matches no other, if there is one."""
    out, into = pair
    at_publisher = f"{mismatch.raise_offer} at the publisher"
    at_subscriber = f"{mismatch.lower_ask} at the subscriber"
    if any(serves(out, other) for other in seen.subscribers):
        change = at_subscriber
    elif any(serves(other, into) for other in seen.publishers):
        change = at_publisher
    else:
        change = f"{at_publisher}, or {at_subscriber}"
    return (
        f"{mismatch.policy}: publisher {who(out)} offers {mismatch.offered}, subscriber {who(into)} requests "
        f"{mismatch.asked}; set {change}"
    )


def who(end: api.EndpointFact) -> str:
    return clean(end.node, 80) or "(unnamed node)"


def some(texts: Sequence[str]) -> str:
    shown = ", ".join(texts[:SHOWN])
    return shown if len(texts) <= SHOWN else f"{shown} and {len(texts) - SHOWN} more"
