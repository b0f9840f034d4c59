"""Facts from the ROS probe: the graph, rates, beacons and diagnostics. Part of `phm.facts`; import them from there.

Times named `age_s` or `silent_s` are seconds before the call on the monotonic clock, unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

DIAGNOSTICS, CONSENSUS = "/diagnostics", "/phm/consensus"
"""Topics on which PHM publishes diagnostic_msgs/DiagnosticArray."""


@dataclass(frozen=True, slots=True)
class EndpointFact:
    """One publisher or subscription of a topic, as discovery reports it."""

    node: str
    """Full name, e.g. /agent_1/node_1."""
    type: str
    reliability: str = ""
    durability: str = ""
    deadline_s: float | None = None
    """None: the endpoint has no deadline."""
    liveliness: str = ""
    lease_s: float | None = None
    """Lease duration of its liveliness; None: infinite."""
    type_hash: str = ""
    """Hash of the type definition (REP 2016), shortened; empty if the other side does not send it (Humble)."""


@dataclass(frozen=True, slots=True)
class RateFact:
    """Measurements of the sampler on one topic over its last window; docs/reference/ros.md describes the method."""

    hz: float | None
    """Rate of all publishers together. 0.0: silent. None until two samples far enough apart have been received."""
    silent_s: float | None
    """Since the sampler last saw any publisher advance; None before the first sample."""
    window_s: float = 0.0
    """Publication time over which `hz` was measured."""
    samples: int = 0
    """Number of samples examined so far, not the number published."""
    problem: str = ""
    """Why there is no rate: begins with `type unknown`, `ambiguous` or `QoS mismatch`; empty: there is no problem."""
    limit_s: float | None = None
    """The topic counts as silent after this time, which adapts to the observed pauses. None for a latched topic."""
    jitter_s: float | None = None
    """Estimated standard deviation of the period; see `phm.probes.ros.rates.publisher_stats.Jitter`. None if there are several publishers."""
    age_s: float | None = None
    """Since the newest sample was published, relative to the fastest recent delivery, so that a wrong clock on another
    host does not matter; the delay of that fastest delivery is not known. For a latched topic, relative to the clock
    of this host; None if that clock is behind."""
    publishers: int = 0
    """Number that discovery lists now; a publisher that died is listed until its lease ends."""
    matched: int | None = None
    """Number of them to which the middleware connected the sampler; None: not reported, or the sampler does not listen now."""
    restarts: int = 0
    """Restarts of publishers, detected from sequence numbers or because one publisher replaced another."""
    sample_bytes: float | None = None
    """Mean serialized size of the samples examined."""
    error_hz: float | None = None
    """Standard deviation of `hz` caused by irregular publishing. None until it is known."""
    changed_s: float | None = None
    """How long each measurement has shown a different rate than before; `hz` then covers that time only. None if the
    window contains no such change, or if there are several publishers."""
    not_counted_s: float = 0.0
    """The part of silent_s in which the ROS child did not run."""


@dataclass(frozen=True, slots=True)
class OutsideFact:
    """A field with values outside of its range. value: the newest of them, as text: it may be NaN."""

    field: str
    value: str


@dataclass(frozen=True, slots=True)
class FieldFact:
    """The value of one field in the newest examined message (a check of type `topic`). Of an array: of all its elements."""

    field: str
    """As configured, e.g. `status.level` or `ranges[0]`."""
    low: float | None = None
    """The lowest number; None: text, an empty array, or no number but NaN. Infinity is the largest finite number."""
    high: float | None = None
    """The highest; with several publishers, of all of them."""
    nan: bool = False
    """Whether a number is NaN."""
    text: str = ""
    """The text of a text field, from outside and shortened."""
    problem: str = ""
    """Why the field cannot be read; empty: it was read."""


@dataclass(frozen=True, slots=True)
class DataFact:
    """What the messages of one topic contain, from the few that are examined (`ros.topics[].data`). With several publishers,
    each number is that of the worst."""

    conditions: tuple[str, ...] = ()
    """The limits that are exceeded now: `data_stamp`, `data_order`, `data_frozen`, `data_range`, `data_gaps`."""
    samples: int = 0
    """Messages examined so far."""
    problem: str = ""
    """Why something configured cannot be examined: wrong type, unknown field, message too large; empty: all is examined."""
    age_s: float | None = None
    """Reception of the newest message minus its stamp, by the system clock of this machine; below 0: in the future. While
    `data_stamp` lasts: of the newest message with a wrong stamp."""
    unset: bool = False
    """The newest stamp is 0."""
    backs: int = 0
    """How many of the newest messages have an older stamp than the one before."""
    back_s: float = 0.0
    """The largest of these steps."""
    frozen_s: float = 0.0
    """How long messages have had the same content."""
    lost_percent: float | None = None
    """Share of the counter's values that were not published."""
    outside: tuple[OutsideFact, ...] = ()
    fields: tuple[FieldFact, ...] = ()
    """The fields that checks of type `topic` name."""
    undecided: tuple[str, ...] = ()
    """The limits of which too little was examined to say whether they are exceeded, named as in `conditions`. Content that is the
    same since a publisher was first examined may be as old as before."""


@dataclass(frozen=True, slots=True)
class TopicFact:
    """One topic in the newest snapshot of the graph."""

    publishers: tuple[EndpointFact, ...] = ()
    subscribers: tuple[EndpointFact, ...] = ()
    rate: RateFact | None = None
    data: DataFact | None = None
    """None: not configured, or no message was examined yet."""


@dataclass(frozen=True, slots=True)
class NameFact:
    """Users of a topic that is not configured: full names of nodes, each once."""

    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class NeighbourFact:
    """What the beacon of one node reports about another node that has a beacon. age_s: as the reporting node measured it.

    late_s: delay of the other node's executor, as the reporting node received it.
    """

    alive: bool
    age_s: float
    late_s: float = 0.0


VIEWS_S = 1.5
"""A beacon repeats what its node receives from others once a second (`phm.beacon`), so its newest report is at most this much older than
its newest heartbeat."""


class Reception(NamedTuple):
    """A node as another one receives it. by: full name of the other one. ago_s: at most this long ago. late_s: delay of its executor."""

    by: str
    ago_s: float
    late_s: float


@dataclass(frozen=True, slots=True)
class BeaconFact:
    """The newest beacon of one node (`phm.beacon`).

    period_s:   its intended period between heartbeats.
    late_s:     how late its executor was at the newest heartbeat, as the node itself reports.
    birth:      changes when the node is restarted.
    heartbeats: number since the node started, at most a second old; for a node that is not configured, as of its last
                change.
    views:      what it reports about its neighbours, by full node name.
    full:       its list of neighbours had no space for more: a node that `views` does not contain may be received.
    turns:      number of turns of its executor since the node started, as of the same time; 0: none yet, or the executor
                is not watched, and late_s means nothing.
    ran_since:  its executor has run at least twice since this time (monotonic seconds), as their number shows. None: unknown. Unlike
                late_s, which a process that gets no CPU does not count, it is never too new.
    witness:    the process that sends the beacon; all nodes of a process receive as one.
    rivals:     number of other processes that send heartbeats under the same name. Each rival, and this process, must have
                sent several since the rival began.
    copied_by:  name of the other node or writer that uses the identity of this process; its messages are refused, but
                reported.
    """

    age_s: float
    period_s: float
    late_s: float = 0.0
    birth: str = ""
    heartbeats: int = 0
    views: Mapping[str, NeighbourFact] = field(default_factory=dict)
    turns: int = 0
    witness: str = ""
    rivals: int = 0
    copied_by: str = ""
    not_counted_s: float = 0.0
    """The part of age_s in which the ROS child did not run."""
    full: bool = False
    ran_since: float | None = None

    @property
    def silent_s(self) -> float:
        """The part of its age that counts as silence."""
        return max(0.0, self.age_s - self.not_counted_s)

    @property
    def missed(self) -> float:
        """Periods since the last heartbeat."""
        return self.silent_s / self.period_s


@dataclass(frozen=True, slots=True)
class DiagnosticFact:
    """One diagnostic_msgs/DiagnosticStatus that the application, or PHM itself, published.

    level: 0 OK, 1 WARN, 2 ERROR, 3 STALE; other values are possible, because it is external input.
    """

    age_s: float
    level: int
    message: str = ""
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    not_counted_s: float = 0.0
    """The part of age_s in which the ROS child did not run."""


@dataclass(frozen=True, slots=True)
class AnswerFact:
    """What a service answers that PHM calls repeatedly: `get_state` of a lifecycle node, a service of `ready.call`, or one of a
    check of type `service`."""

    answer: str = ""
    """The newest answer of the current server: a lifecycle state, e.g. `active`; `true` or `false` as `success` of its response,
    and `true` if that has no such field. Empty before the first one."""
    detail: str = ""
    """The text of that answer, from outside."""
    served: bool = False
    """Whether discovery lists the service."""
    unanswered_s: float = 0.0
    """How long the server has not answered, without time in which the ROS child did not run; 0.0: it answers."""
    problem: str = ""
    """Why it cannot be called; empty: there is no problem."""


@dataclass(frozen=True, slots=True)
class RosFact:
    """The newest snapshot of the ROS graph from the child process.

    age_s:       since the child made it, or found it unchanged.
    up_s:        how long this child has observed the graph without an interruption in which it did not run and leases may
                 have ended. A graph that has been observed for only a second does not prove absence.
    nodes:       full name -> how often it is listed.
    topics:      configured topics, those of `ready.topics` too, by full name.
    beacons:     those received since this child started, by full node name.
    diagnostics: those received since this child started, by the name of the status. If several publishers use it: the newest.
    others:      topics that are not configured, by full name, a few seconds old; incomplete if there are very many.
    refused:     messages on the beacon topic since this child started that were not beacons, or were too many.
    names_known: whether the names of nodes could be read.
    lost_s:      since more beacons arrived than PHM reads; None: never. A beacon that has been silent for longer is left
                 out, because its silence proves nothing.
    listened_s:  how long this child has existed, interruptions included.
    services:    how often discovery lists a server of each service of `ready.services` or of a check of type `service`, by
                 full name; None: unknown.
    lifecycle:   states of the nodes with `ready.lifecycle` or a check of type `lifecycle`, by full name.
    calls:       answers of the services that are called, by full name.
    diagnostic_sources: the newest status of each publisher, for names that several publishers use.
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
    services: Mapping[str, int | None] = field(default_factory=dict)
    lifecycle: Mapping[str, AnswerFact] = field(default_factory=dict)
    calls: Mapping[str, AnswerFact] = field(default_factory=dict)
    diagnostic_sources: Mapping[str, tuple[DiagnosticFact, ...]] = field(default_factory=dict)

    @property
    def listened_for_s(self) -> float:
        """How long PHM has listened for messages that are sent rarely: an interruption only loses its own duration."""
        return max(self.up_s, self.listened_s)

    def received_elsewhere(self, node: str, without: Collection[str] = ()) -> Reception | None:
        """The newest report of another process that it receives this node's beacon; None: there is none, or the node has no beacon.
        without: names of nodes whose reports do not count."""
        own = self.beacons.get(node)
        if own is None:
            return None
        reports = (
            Reception(name, view.age_s + VIEWS_S + other.age_s, view.late_s)
            for name, other in self.beacons.items()
            if other.witness != own.witness and name not in without
            if (view := other.views.get(node)) is not None and view.alive
        )
        return min(reports, key=lambda report: report.ago_s, default=None)

    def received_only_elsewhere(self, node: str) -> Reception | None:
        """Proof that the node has sent since PHM last received its beacon: PHM's own participant receives nothing from it."""
        report = self.received_elsewhere(node)
        silent_s = self.beacons[node].silent_s - self.age_s if report is not None else 0.0
        return report if report is not None and report.ago_s < silent_s else None


class RosProbe(Protocol):
    """Reads the ROS graph through the ROS child."""

    def snapshot(self) -> RosFact:
        """Return the newest snapshot. Raises CannotTell if rclpy is missing, or the child is being replaced or is silent."""
