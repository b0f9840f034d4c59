"""Signs that a node continued to run after something at one of its topics had ended: then the topic is at fault, not the node.

A node shows that it is alive by its beacon, and by topics that only it publishes. Pure rules, used by `topics` and `rates`.
"""

from __future__ import annotations

from collections.abc import Iterable

from phm import api

BEAT_S = 0.2
"""A beacon message that is this much newer than the end of something came after it: PHM sees the end immediately, or at a poll that
may be late."""
POLL_S = 0.3
"""Topics are polled every 0.25 s: data that a poll finds arrived up to this much earlier."""
TURN_S = 1.0
"""How often a beacon asks its executor to run (`phm.beacon`). An executor that was late ran that much earlier."""
FRESH_S = 0.75
"""A sign of life up to this old still shows the present state: beacons arrive every 0.2 s, and PHM reads and passes them on with the
polls."""


def went_on(node: str, fact: api.RosFact, since_s: float) -> bool:
    """Whether the node is listed exactly once and has given a sign of life within the last `since_s` seconds."""
    return fact.nodes.get(node) == 1 and sign_s(node, fact) <= since_s


def all_alive(ends: Iterable[api.EndpointFact], fact: api.RosFact) -> bool:
    """Whether each of these endpoints belongs to a node with a single, living process: none is a stale entry of a dead node."""
    return all(went_on(end.node, fact, FRESH_S) for end in ends)


def sign_s(node: str, fact: api.RosFact) -> float:
    """Upper bound of the time since the node's newest sign of life; infinite if it gives none."""
    ages = [silent_s + POLL_S for silent_s in _flows(node, fact)]
    beacon = fact.beacons.get(node)
    if beacon is not None:
        ages.append(beacon.age_s + BEAT_S)
    return min(ages, default=float("inf"))


def turned_s(node: str, fact: api.RosFact) -> float:
    """Upper bound of the time since the node's executor last ran; infinite if unknown."""
    ages = [silent_s + POLL_S for silent_s in _flows(node, fact)]
    beacon = fact.beacons.get(node)
    if beacon is not None and beacon.turns:
        ages.append(beacon.age_s + beacon.late_s + TURN_S)
    return min(ages, default=float("inf"))


def ran_s(node: str, fact: api.RosFact, now_s: float) -> float:
    """Upper bound of the time in which the node's executor ran at least twice, by its number of turns, or published on another topic;
    infinite if unknown. now_s: monotonic seconds.

    Its own report of how late it is does not count a time in which the entire process got no CPU, so it does not prove that it ran.
    """
    ages = [silent_s + POLL_S for silent_s in _flows(node, fact)]
    beacon = fact.beacons.get(node)
    if beacon is not None and beacon.ran_since is not None:
        ages.append(max(0.0, now_s - beacon.ran_since))
    return min(ages, default=float("inf"))


def _flows(node: str, fact: api.RosFact) -> Iterable[float]:
    """Seconds since the last observed data on each topic that only this node publishes."""
    for topic in fact.topics.values():
        rate = topic.rate
        if rate is None or rate.silent_s is None or rate.problem or not topic.publishers:
            continue
        if all(end.node == node for end in topic.publishers):
            yield rate.silent_s
