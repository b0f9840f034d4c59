"""Section `ros`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import Bytes, Hertz, Name, Percent, RosName, Seconds, Section
from phm.core.settings.readiness import NodeReadySettings


class NodeSettings(Section):
    """One ROS node that must run."""

    name: RosName
    """Full name, e.g. /agent_1/node_1 (a missing first slash is added)."""
    container: Name | None = None
    """The container it runs in; default: the only configured one. Recovery restarts it."""
    process: list[Annotated[str, Field(min_length=1, max_length=255)]] = Field(default_factory=list)
    """Words that all occur in the command line of its process, and of no other in its container; default: detected."""
    relaunch: list[str] = Field(default_factory=list)
    """Command, word by word, that starts this node inside its container; tried before the container is restarted."""
    beacon: Literal["auto", "required"] = "auto"
    """`required`: it is an error when the node runs and no beacon (`phm.beacon`) is received from it."""
    ready: NodeReadySettings | None = None
    """What it must provide to be ready, e.g. its lifecycle state; default: readiness is not checked."""
    commands: bool = False
    """True: commands from the ground pass through this node to the autopilot, so it is part of the command path."""


FieldName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*$", max_length=255)]
FieldPath = Annotated[
    str, Field(pattern=r"^[a-z][a-z0-9_]*(\[\d{1,5}\])?(\.[a-z][a-z0-9_]*(\[\d{1,5}\])?)*$", max_length=255)
]
"""A field of a message, with the index of an element where it is in an array: `pose.position.z`, `cells[0].voltage`."""
Bound = Annotated[float, Field(allow_inf_nan=False)] | None


class DataSettings(Section):
    """What the messages of a topic must contain. Few of them are examined; only what is configured is."""

    max_age: Annotated[Seconds, Field(gt=0, le=3600)] | None = None
    """Maximum difference of `header.stamp` to the system clock, in both directions; default: not checked."""
    order: bool = False
    """True: `header.stamp` must not go back."""
    frozen: Annotated[Seconds, Field(gt=0, le=3600)] | None = None
    """The content, without stamps and counter, must change within this time; default: not checked."""
    counter: FieldName | None = None
    """Field that its source increases by one for each message, e.g. `seq`; skipped numbers are gaps. Default: none."""
    gaps: Percent = 5.0
    """Share of the counter's numbers that may be missing; ERROR from twice as many."""
    ranges: Annotated[
        dict[FieldPath, Annotated[list[Bound], Field(min_length=2, max_length=2)]], Field(max_length=16)
    ] = Field(default_factory=dict)
    """Lowest and highest value of fields, e.g. `twist.linear.x` or `cells[0].voltage`; null: no limit. Of an array, each element counts."""
    sample: Annotated[Hertz, Field(gt=0, le=4)] = 2.0
    """At most this many messages per second of each publisher are examined."""


class TopicSettings(Section):
    """One ROS topic that must have data."""

    name: RosName
    """Full name, e.g. /agent_1/topic_1 (a missing first slash is added)."""
    type: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$")] | None = None
    """Expected type, e.g. std_msgs/msg/String; default: not checked."""
    rate: Annotated[Hertz, Field(ge=0)] | None = None
    """Expected rate in Hz; 0 for a latched topic (only its publisher is checked); default: not checked."""
    tolerance: Percent = 10.0
    """Deviation of the rate for WARN."""
    error_tolerance: Percent | None = None
    """Deviation of the rate for ERROR; default: twice `tolerance`."""
    silence: Annotated[Seconds, Field(gt=0, le=600)] | None = None
    """Replaces `ros.silence` for this topic."""
    publishers: list[RosName] = Field(default_factory=list)
    """Nodes that must publish it; default: any node."""
    subscribers: list[RosName] = Field(default_factory=list)
    """Nodes that must subscribe to it; default: none."""
    container: Name | None = None
    """The container it comes from; default: that of its first publisher, else the only configured one."""
    data: DataSettings | None = None
    """What its messages must contain; default: not examined."""

    @property
    def error_limit(self) -> float:
        """Deviation of the rate for ERROR, percent."""
        return 2 * self.tolerance if self.error_tolerance is None else self.error_tolerance


class WatchedDiagnosticSettings(Section):
    """Statuses of the application on /diagnostics that are evaluated together."""

    name: Annotated[str, Field(min_length=1, max_length=255)]
    """Name of the status, e.g. `camera: Frequency`, or a pattern with `*` and `?`; the worst of all that match counts."""
    container: Name | None = None
    """The container it comes from; default: that of its node, else the only configured one."""
    node: RosName | None = None
    """The node that publishes it; default: the configured node whose name precedes the colon, if any."""
    timeout: Annotated[Seconds, Field(ge=0.5, le=600)] = 5.0
    """A status not received for this long is stale."""
    when_stale: Literal["error", "warn", "stale"] = "error"
    """Level of a stale status, also of one that was never received or reports STALE itself. `stale` opens no fault."""


class DiagnosticsSettings(Section):
    """ROS diagnostics: publishing PHM's status, and monitoring the application's."""

    publish: bool | None = None
    """True: PHM publishes its status on /diagnostics. Default: when anything else of `ros` is configured."""
    listen: Annotated[list[RosName], Field(max_length=4)] = Field(default_factory=lambda: ["/diagnostics"])
    """Topics of diagnostic_msgs/DiagnosticArray that are read."""
    watch: list[WatchedDiagnosticSettings] = Field(default_factory=list)
    """Statuses that must exist and be OK."""


class ConsensusSettings(Section):
    """The consensus of the nodes about each other, from their beacons."""

    publish: bool = True
    """True: PHM publishes it on /phm/consensus, once a node has a beacon."""
    open_faults: bool = True
    """True: a node that most nodes do not receive is ERROR `quorum_dead`, also while PHM itself receives it, and a subscriber that has
    lost its publisher is ERROR `publisher_not_received`. False: WARN `partly_received`."""


class RosSettings(Section):
    """The ROS graph of this agent."""

    domain: Annotated[int, Field(ge=0, le=232)] | None = None
    """ROS_DOMAIN_ID; default: that of PHM's environment, else 0."""
    nodes: list[NodeSettings] = Field(default_factory=list)
    """Nodes that must run."""
    topics: list[TopicSettings] = Field(default_factory=list)
    """Topics that must have data."""
    diagnostics: DiagnosticsSettings = DiagnosticsSettings()
    """ROS diagnostics, out and in."""
    consensus: ConsensusSettings = ConsensusSettings()
    """The consensus of the nodes about each other."""
    grace: Annotated[Seconds, Field(ge=0, le=120)] = 8.0
    """Seconds after a start or restart in which an incomplete graph is not yet a fault. 2 s later a restart by PHM has failed if its nodes
    are still missing."""
    silence: Annotated[Seconds, Field(gt=0, le=60)] = 3.0
    """A topic without a message for max(three periods, this) is silent; sooner if it never paused for this long."""
    max_memory: Annotated[Bytes, Field(ge=50e6)] = 250e6
    """The ROS child process is replaced when it uses more."""
    installs: list[Annotated[str, Field(pattern=r"^/[^:]*$", max_length=4096)]] = Field(default_factory=list)
    """Directories `install/` of the application's workspaces, mounted for PHM, for message types that it cannot read otherwise."""

    @property
    def used(self) -> bool:
        return bool(self.nodes or self.topics or self.diagnostics.watch or self.diagnostics.publish)

    @property
    def publishes(self) -> bool:
        """Whether PHM publishes its status on /diagnostics."""
        return self.used if self.diagnostics.publish is None else self.diagnostics.publish
