"""Limits the part of the graph that PHM passes on. Pure.

Any participant of the ROS domain can announce any number of nodes and endpoints. Configured ones come first, so that
others cannot displace them; the others share the rest.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from itertools import islice

from phm.facts.ros import EndpointFact

MAX_STRANGERS = 300
"""Maximum number of nodes that are not configured."""
FEW_ENDS = 400
"""This many endpoints always fit into a message, regardless of the length of their names."""
ENDS_BYTES = 500_000
"""Bytes for all endpoints of one graph message, which may have 1 MB."""
_REST_BYTES = 160
"""Bytes of an endpoint besides the name of its node and its type."""

Ends = Mapping[str, tuple[EndpointFact, ...]]


def kept_nodes(listed: Mapping[str, int], configured: Collection[str]) -> tuple[dict[str, int], bool]:
    """Nodes by name, and whether some were dropped."""
    own = {name: count for name, count in listed.items() if name in configured}
    strangers = {name: count for name, count in listed.items() if name not in configured}
    kept = dict(islice(sorted(strangers.items()), MAX_STRANGERS))
    return dict(sorted({**own, **kept}.items())), len(kept) < len(strangers)


def kept_ends(sides: tuple[Ends, Ends], configured: Collection[str]) -> tuple[tuple[Ends, Ends], bool]:
    """Publishers and subscribers by topic, and whether some were dropped: unconfigured ones first, then those listed
    several times."""
    if sum(len(ends) for side in sides for ends in side.values()) <= FEW_ENDS:
        return sides, False
    ranked = sorted(
        (
            (rank, number, topic, at, end)
            for number, side in enumerate(sides)
            for topic, ends in side.items()
            for at, (rank, end) in enumerate(_ranked(ends, configured))
        ),
        key=lambda item: item[:4],
    )
    kept: tuple[dict[str, list[EndpointFact]], ...] = tuple({topic: [] for topic in side} for side in sides)
    left = ENDS_BYTES
    for _, number, topic, _, end in ranked:
        left -= len(json.dumps(end.node)) + len(json.dumps(end.type)) + _REST_BYTES
        if left < 0:
            break
        kept[number][topic].append(end)
    publishers, subscribers = ({topic: _ordered(ends) for topic, ends in side.items()} for side in kept)
    return (publishers, subscribers), left < 0


def _ranked(ends: tuple[EndpointFact, ...], configured: Collection[str]) -> list[tuple[int, EndpointFact]]:
    """Rank 0: of a configured node, once each; 1: all others."""
    met: set[str] = set()
    found = []
    for end in ends:
        first = end.node in configured and end.node not in met
        met.add(end.node)
        found.append((0 if first else 1, end))
    return found


def _ordered(ends: list[EndpointFact]) -> tuple[EndpointFact, ...]:
    return tuple(sorted(ends, key=lambda end: (end.node, end.type)))
