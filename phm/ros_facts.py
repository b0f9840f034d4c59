"""What the ROS probe says: the graph, rates, beacons and diagnostics. Part of `phm.facts`, and imported from there.

Times named `age_s` or `silent_s` are seconds before the call on the monotonic clock, unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class EndpointFact:
    """One publisher or subscription of a topic, as discovery reports it."""

    node: str
    """Full name, e.g. /agent_1/node_1."""
    type: str
    reliability: str = ""
    durability: str = ""


@dataclass(frozen=True, slots=True)
class RateFact:
    """What the sampler measured on one topic over its last window.

    hz:       None until two samples far enough apart have been seen.
    silent_s: seconds since the sampler last saw the publisher advance; None before the first sample.
    problem:  a reason why there is no rate (`type unknown`, `ambiguous`), or empty.
    """

    hz: float | None
    silent_s: float | None
    window_s: float = 0.0
    samples: int = 0
    problem: str = ""


@dataclass(frozen=True, slots=True)
class TopicFact:
    publishers: tuple[EndpointFact, ...] = ()
    subscribers: tuple[EndpointFact, ...] = ()
    rate: RateFact | None = None


@dataclass(frozen=True, slots=True)
class NeighbourFact:
    """What one node's beacon says about another node that has a beacon. age_s: as that node measured it."""

    alive: bool
    age_s: float


@dataclass(frozen=True, slots=True)
class BeaconFact:
    """The newest beacon of one node (`phm.beacon`).

    period_s: how often it means to send. late_s: how late its executor ran its newest beat, by its own word.
    birth: changes when the node is started anew. beats: how many it has sent in this life. views: what it
    says about its neighbours, by full node name.
    """

    age_s: float
    period_s: float
    late_s: float = 0.0
    birth: str = ""
    beats: int = 0
    views: Mapping[str, NeighbourFact] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DiagnosticFact:
    """One status that the application published on /diagnostics. level: 0 OK, 1 WARN, 2 ERROR, 3 STALE."""

    age_s: float
    level: int
    message: str = ""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RosFact:
    """The newest picture of the ROS graph from the child process.

    age_s: since the child sent it. up_s: how long this child has been looking; a graph that is only a
    second old does not prove absence. nodes: full name -> how often it is listed. topics: those that
    the configuration names, by full name. beacons: by full node name, those heard since this child began.
    diagnostics: by the name of the status, likewise.
    """

    age_s: float
    up_s: float
    nodes: Mapping[str, int] = field(default_factory=dict)
    topics: Mapping[str, TopicFact] = field(default_factory=dict)
    beacons: Mapping[str, BeaconFact] = field(default_factory=dict)
    diagnostics: Mapping[str, DiagnosticFact] = field(default_factory=dict)


class RosProbe(Protocol):
    def look(self) -> RosFact:
        """Raises CannotTell when rclpy is missing, or the child is being replaced or is silent."""
