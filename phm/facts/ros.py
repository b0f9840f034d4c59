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
    deadline_s: float | None = None
    """None: it has no deadline."""
    liveliness: str = ""
    lease_s: float | None = None
    """Of its liveliness; None: without end."""
    type_hash: str = ""
    """Of the definition of the type (REP 2016), shortened; empty where the other side does not send it (Humble)."""


@dataclass(frozen=True, slots=True)
class RateFact:
    """What the sampler measured on one topic over its last window. See docs/reference/ros.md for how."""

    hz: float | None
    """Of all publishers together. 0.0: silent. None until two samples far enough apart have been seen."""
    silent_s: float | None
    """Since the sampler last saw a publisher advance; None before the first sample."""
    window_s: float = 0.0
    """Publication time that `hz` was measured over."""
    samples: int = 0
    """Looked at so far; not those published."""
    problem: str = ""
    """Why there is no rate: begins with `type unknown`, `ambiguous` or `QoS mismatch`; or empty."""
    limit_s: float | None = None
    """Silent from here on: adapts to the pauses that were seen. None for a latched topic."""
    jitter_s: float | None = None
    """Standard deviation of the period, estimated; see `phm.probes.ros.rates.publisher_stats.Jitter`. None with several publishers."""
    age_s: float | None = None
    """Since the newest sample was published, against the quickest delivery of late, so that a clock of another host
    that is off does not matter; how late the quickest one was is not known. Of a latched topic against the clock of
    this host, and None where that clock is behind."""
    publishers: int = 0
    """How many discovery lists now; one that died is listed until its lease ends."""
    matched: int | None = None
    """To how many of them the middleware connected the sampler; None where it does not report it, or while not listening."""
    restarts: int = 0
    """Publishers seen to start again, by their sequence numbers or by one that took another's place."""
    sample_bytes: float | None = None
    """Size of a sample, serialized, averaged over those looked at."""
    error_hz: float | None = None
    """Standard deviation of `hz` that comes from the publisher's own unevenness. None until it is known."""
    changed_s: float | None = None
    """For how long each single look has shown another rate than before, which alone `hz` is then. None when the
    window holds no such change, and with several publishers."""
    not_counted_s: float = 0.0
    """Of silent_s, the time in which the ROS child did not run."""


@dataclass(frozen=True, slots=True)
class TopicFact:
    publishers: tuple[EndpointFact, ...] = ()
    subscribers: tuple[EndpointFact, ...] = ()
    rate: RateFact | None = None


@dataclass(frozen=True, slots=True)
class NameFact:
    """Who uses a topic that the configuration does not name: full names of nodes, each once."""

    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NeighbourFact:
    """What one node's beacon says about another node that has a beacon. age_s: as that node measured it.

    late_s: how late the other's executor is, as that node received it.
    """

    alive: bool
    age_s: float
    late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class BeaconFact:
    """The newest beacon of one node (`phm.beacon`).

    period_s: how often it means to send. late_s: how late its executor ran its newest beat, by its own word.
    birth: changes when the node is restarted. beats: how many it has sent in this life, as of a second ago at most; of
    a node that is not configured, as of its last news. views: what it says about its neighbours, by full node name. turns:
    how often its executor turned in this life, as of the same moment; 0: never yet, or it is not watched, and late_s means
    nothing. witness: the process that speaks; its nodes hear as one.
    rivals: how many other processes beat under the same name, each and this one several times since it began.
    copied_by: who else uses the identity of this process (name of a node, or of a writer); refused, but reported.
    """

    age_s: float
    period_s: float
    late_s: float = 0.0
    birth: str = ""
    beats: int = 0
    views: Mapping[str, NeighbourFact] = field(default_factory=dict)
    turns: int = 0
    witness: str = ""
    rivals: int = 0
    copied_by: str = ""
    not_counted_s: float = 0.0
    """Of age_s, the time in which the ROS child did not run."""

    @property
    def silent_s(self) -> float:
        """What of its age is its silence."""
        return max(0.0, self.age_s - self.not_counted_s)

    @property
    def missed(self) -> float:
        """Periods since the last beat."""
        return self.silent_s / self.period_s


@dataclass(frozen=True, slots=True)
class DiagnosticFact:
    """One status of diagnostic_msgs/DiagnosticStatus: what the application published, or what PHM publishes itself.

    level: 0 OK, 1 WARN, 2 ERROR, 3 STALE; others are possible, as it comes from outside.
    """

    age_s: float
    level: int
    message: str = ""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    not_counted_s: float = 0.0
    """Of age_s, the time in which the ROS child did not run."""


@dataclass(frozen=True, slots=True)
class RosFact:
    """The newest picture of the ROS graph from the child process.

    age_s: since the child made it, or found nothing changed. up_s: how long this child has been looking, without a break in which
    it did not run and leases may have ended; a graph that is only a second old does not prove absence. nodes: full name -> how
    often it is listed. topics: those that the configuration names, by full name. beacons: by full node name, those heard since this child began.
    diagnostics: by the name of the status, likewise. others: topics that the configuration does not name, by full
    name, as of a few seconds ago; not all of them where there are very many. refused: messages on the beacons' topic that
    were none, or were too many, since this child began. names_known: whether the names of nodes could be read.
    lost_s: since more beacons came than PHM reads; None: never. A beacon that has been silent for longer is left out, since its
    silence proves nothing. listened_s: how long this child has existed, whatever breaks there were.
    """

    age_s: float
    up_s: float
    nodes: Mapping[str, int] = field(default_factory=dict)
    topics: Mapping[str, TopicFact] = field(default_factory=dict)
    beacons: Mapping[str, BeaconFact] = field(default_factory=dict)
    diagnostics: Mapping[str, DiagnosticFact] = field(default_factory=dict)
    others: Mapping[str, NameFact] = field(default_factory=dict)
    refused: int = 0
    names_known: bool = True
    lost_s: float | None = None
    listened_s: float = 0.0

    @property
    def heard_for_s(self) -> float:
        """How long something that is sent rarely has been listened for: of that time a break loses only itself."""
        return max(self.up_s, self.listened_s)


class RosProbe(Protocol):
    def look(self) -> RosFact:
        """Raises CannotTell when rclpy is missing, or the child is being replaced or is silent."""
