"""Signs that a node went on after something at one of its topics had ended: then it is the topic's own fault, and not the node's.

A node says that it lives by its beacon, and by topics that it alone publishes. Pure rules, used by `topics` and `rates`.
"""

from __future__ import annotations

from collections.abc import Iterable

from phm import api

BEAT_S = 0.2
"""A beat this much younger than the end of something came after it: the end is seen at once, or by a look that may be late."""
LOOK_S = 0.3
"""Topics are looked at every 0.25 s: what was seen to flow at a look flowed up to this much before."""
TURN_S = 1.0
"""How often a beacon asks its executor to turn (`phm.beacon`). One that was late has turned that much earlier."""
FRESH_S = 0.75
"""A sign of life this old is a sign for now: beats come every 0.2 s, and are read and told with the looks."""


def went_on(node: str, fact: api.RosFact, since_s: float) -> bool:
    """Whether the node, which is listed once, has given a sign of life after the moment `since_s` ago."""
    return fact.nodes.get(node) == 1 and sign_s(node, fact) <= since_s


def all_alive(ends: Iterable[api.EndpointFact], fact: api.RosFact) -> bool:
    """Whether each of these ends belongs to a node of one process that lives now: none is the ghost of a dead one."""
    return all(went_on(end.node, fact, FRESH_S) for end in ends)


def sign_s(node: str, fact: api.RosFact) -> float:
    """How long ago the node's newest sign of life was given, at most; infinite where it gives none."""
    ages = [silent_s + LOOK_S for silent_s in _flows(node, fact)]
    beacon = fact.beacons.get(node)
    if beacon is not None:
        ages.append(beacon.age_s + BEAT_S)
    return min(ages, default=float("inf"))


def turned_s(node: str, fact: api.RosFact) -> float:
    """How long ago the node's executor turned, at most; infinite where nobody knows."""
    ages = [silent_s + LOOK_S for silent_s in _flows(node, fact)]
    beacon = fact.beacons.get(node)
    if beacon is not None and beacon.turns:
        ages.append(beacon.age_s + beacon.late_s + TURN_S)
    return min(ages, default=float("inf"))


def _flows(node: str, fact: api.RosFact) -> Iterable[float]:
    """Seconds since each topic that the node alone publishes was last seen to flow."""
    for topic in fact.topics.values():
        rate = topic.rate
        if rate is None or rate.silent_s is None or rate.problem or not topic.publishers:
            continue
        if all(end.node == node for end in topic.publishers):
            yield rate.silent_s
