"""Subscribers that may be missing because no one needs them: a node may subscribe only while someone uses what it publishes."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from phm import api
from phm_checks._text import listed

OTHERS_S = 3.0
"""A subscription that its node may not need any more must be lost for longer than the age of the users of topics that are not configured:
those are read every two seconds (`phm.probes.ros.unconfigured_topics`)."""
MANY = 190
"""With so many topics that are not configured, some may be missing in the snapshot, those that are used first."""
STATEMENTS = ("/diagnostics", "/events/write_split")
"""Topics about the publisher itself: who reads them does not use its output."""


class Use(Enum):
    """Whether anyone uses what a node publishes, PHM aside."""

    NONE = "none"
    """It publishes, and no one subscribes: it may have closed its own subscriptions, as image_proc does, until someone does."""
    OLD = "old"
    """Someone subscribed when the users of topics that are not configured were read."""
    OTHER = "other"
    """Someone subscribes, or it publishes nothing."""


def use_of_output(node: str, fact: api.RosFact) -> Use:
    """node: the full name."""
    statements = (*STATEMENTS, f"{node}/transition_event")  # each lifecycle node has the latter
    configured = [
        topic
        for name, topic in fact.topics.items()
        if name not in statements and any(end.node == node for end in topic.publishers)
    ]
    others = [topic for name, topic in fact.others.items() if node in topic.publishers and name not in statements]
    if (
        len(fact.others) >= MANY
        or any(end.node != node for topic in configured for end in topic.subscribers)
        or not (configured or others)
    ):
        return Use.OTHER
    return Use.OLD if any(user != node for topic in others for user in topic.subscribers) else Use.NONE


def on_demand(name: str, nodes: Sequence[str]) -> api.Result:
    """The result for a topic that has lost no subscriber but these."""
    return api.stale(
        f"topic {name} has lost its subscriber {listed(nodes)}, which may subscribe on demand: no node subscribes to what it publishes. If so, "
        "remove it from `subscribers`"
    )
