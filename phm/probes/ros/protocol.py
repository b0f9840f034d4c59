"""The protocol between the daemon and its ROS child process: one JSON object per line, over pipes.

The daemon writes one `Wanted`, then any number of `Publish`, and closes the pipe at the end.

The child writes first `Sandbox`, or `Missing` without usable ROS. Then it writes `GraphMessage` after each change and at
least once a second, `Tick` in between, `SelfReportUpdate` after beacons or diagnostics, `OtherTopics` when unconfigured
topics appear or disappear, `ReadinessUpdate` where readiness is configured, and `LogText` for the log.

The child imports this module: standard library and facts only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NoReturn

from phm.facts.ros import DIAGNOSTICS, AnswerFact, BeaconFact, DiagnosticFact, NameFact, TopicFact
from phm.probes.ros.fact_codec import pack, value

LINE_LIMIT = 1_000_000
"""Longest line in bytes. A graph of 200 topics with 10 endpoints each takes about 200 kB."""

INSTALLS = "PHM_ROS_INSTALLS"
"""Environment variable of the child with the folders of `ros.installs`, separated as in PATH."""

EXIT_MISSING = 69
"""The child's exit code without usable ROS (EX_UNAVAILABLE of sysexits.h)."""


class ProtocolError(ValueError):
    """A line that is not a message, e.g. output of a library, or a line cut by a crash."""


@dataclass(frozen=True, slots=True)
class WantedRange:
    """Limits of one field; None: no limit."""

    field: str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class WantedData:
    """What the messages of a topic must contain, as in DataSettings. hz: messages of each publisher examined per second."""

    max_age_s: float | None = None
    order: bool = False
    frozen_s: float | None = None
    counter: str = ""
    gaps_percent: float = 5.0
    ranges: tuple[WantedRange, ...] = ()
    hz: float = 2.0
    fields: tuple[str, ...] = ()
    """Fields whose newest value is reported."""

    @property
    def header(self) -> bool:
        """Whether messages must begin with a header."""
        return self.order or self.max_age_s is not None


@dataclass(frozen=True, slots=True)
class WantedTopic:
    """rate_hz: the expected rate; 0 for a latched topic, None if not measured. silence_s: see RosSettings.silence. data: None:
    its messages are not examined. least_silence_s: the silence limit never falls below this."""

    name: str
    rate_hz: float | None = None
    silence_s: float = 3.0
    data: WantedData | None = None
    least_silence_s: float = 0.0


@dataclass(frozen=True, slots=True)
class WantedCall:
    """A service that is called repeatedly. kind: its type, whose request has no fields. repeat_s: time after which a call
    without an answer is repeated."""

    service: str
    kind: str = "std_srvs/srv/Trigger"
    period_s: float = 2.0
    repeat_s: float = 2.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the child monitors. domain: None means ROS_DOMAIN_ID. tick_s: time between two polls. full_s: between two complete
    graph messages.

    listen: topics of diagnostic_msgs/DiagnosticArray to read. nodes: full names of the configured nodes and of the nodes
    named in topics. watch: patterns of the configured statuses. services: those whose servers are counted. lifecycle: nodes
    whose state is read. calls: services that are called. All names are full.
    """

    agent: str
    domain: int | None = None
    topics: tuple[WantedTopic, ...] = ()
    tick_s: float = 0.25
    full_s: float = 1.0
    listen: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()
    watch: tuple[str, ...] = ()
    services: tuple[str, ...] = ()
    lifecycle: tuple[str, ...] = ()
    calls: tuple[WantedCall, ...] = ()


@dataclass(frozen=True, slots=True)
class GraphMessage:
    """The current graph. up_s: age of the child's participant. number: counts the graph messages of this child. late_s: delay
    of this poll because the child did not get to run.

    names_known: whether node names could be read. problems: sentences about what could not be read or was omitted.
    idle: topics on which PHM publishes and to which no other node subscribes.
    """

    up_s: float
    nodes: Mapping[str, int] = field(default_factory=dict)
    topics: Mapping[str, TopicFact] = field(default_factory=dict)
    number: int = 0
    names_known: bool = True
    problems: tuple[str, ...] = ()
    late_s: float = 0.0
    idle: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Tick:
    """The graph is unchanged since the last graph message. silent_s: seconds of silence of each topic with a rate.

    number: that of the last graph message. If it never arrived, the graph is unknown. late_s: as in `GraphMessage`.
    """

    up_s: float
    silent_s: Mapping[str, float | None] = field(default_factory=dict)
    number: int = 0
    late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SelfReportUpdate:
    """Beacons and diagnostics received since the last message of this kind; silent nodes are omitted.

    ages: seconds, of beacons without other changes. refused: the total, see RosFact. lost: more beacons arrived than can
    be read.
    """

    beacons: Mapping[str, BeaconFact] = field(default_factory=dict)
    diagnostics: Mapping[str, DiagnosticFact] = field(default_factory=dict)
    ages: Mapping[str, float] = field(default_factory=dict)
    refused: int = 0
    lost: bool = False


@dataclass(frozen=True, slots=True)
class OtherTopics:
    """Topics that are not in `Wanted.topics`, by full name, up to a limit."""

    names: Mapping[str, NameFact] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ReadinessUpdate:
    """Servers, lifecycle states and answers of what `Wanted` names, complete. See RosFact."""

    services: Mapping[str, int | None] = field(default_factory=dict)
    lifecycle: Mapping[str, AnswerFact] = field(default_factory=dict)
    calls: Mapping[str, AnswerFact] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class LogText:
    """A sentence for the log."""

    text: str


@dataclass(frozen=True, slots=True)
class Missing:
    """rclpy is not usable. module: what could not be imported. detail: the text of the import error."""

    module: str
    detail: str


@dataclass(frozen=True, slots=True)
class Sandbox:
    """The child has applied its sandbox (`phm.probes.ros.sandbox`). missing: restrictions that the kernel does not support."""

    missing: str = ""


@dataclass(frozen=True, slots=True)
class Publish:
    """From the daemon: publish on `topic`. utc_s: stamp of the array. statuses: by name; their ages are ignored."""

    utc_s: float
    statuses: Mapping[str, DiagnosticFact] = field(default_factory=dict)
    topic: str = DIAGNOSTICS


Message = GraphMessage | Tick | SelfReportUpdate | OtherTopics | ReadinessUpdate | LogText | Missing | Sandbox

_KINDS: Mapping[str, type[Message]] = {
    "graph": GraphMessage,
    "tick": Tick,
    "self_reports": SelfReportUpdate,
    "other_topics": OtherTopics,
    "readiness": ReadinessUpdate,
    "log": LogText,
    "missing": Missing,
    "sandbox": Sandbox,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def encode_wanted(wanted: Wanted) -> bytes:
    return _line(asdict(wanted))


def decode_wanted(line: bytes | str) -> Wanted:
    """The decoded request. Raises ProtocolError."""
    try:
        data = _parsed(line)
        topics = tuple(_topic(**topic) for topic in data.pop("topics"))
        calls = tuple(WantedCall(**call) for call in data.pop("calls"))
        for key in ("listen", "nodes", "watch", "services", "lifecycle"):
            data[key] = tuple(data[key])
        return Wanted(topics=topics, calls=calls, **data)
    except (AttributeError, KeyError, TypeError) as error:
        raise ProtocolError(f"not a configuration: {error}") from error


def _topic(data: Any = None, **fields: Any) -> WantedTopic:
    if data is None:
        return WantedTopic(**fields)
    ranges = tuple(WantedRange(**limits) for limits in data.pop("ranges"))
    data["fields"] = tuple(data["fields"])
    return WantedTopic(**fields, data=WantedData(ranges=ranges, **data))


def encode(message: Message) -> bytes:
    return _line([_NAMES[type(message)], pack(message)])


def decode(line: bytes | str) -> Message:
    """Raises ProtocolError for anything that `encode` did not write."""
    data = _parsed(line)
    try:
        name, fields = data
        message: Message = value(_KINDS[name], fields)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProtocolError(f"not a message: {error!r}") from error
    return message


def encode_order(order: Publish) -> bytes:
    return _line(pack(order))


def decode_order(line: bytes | str) -> Publish:
    """Raises ProtocolError for anything that `encode_order` did not write."""
    try:
        order: Publish = value(Publish, _parsed(line))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ProtocolError(f"not an order: {error!r}") from error
    return order


def _line(data: Any) -> bytes:
    return json.dumps(data, separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _parsed(line: bytes | str) -> Any:
    try:
        return json.loads(line, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"not JSON: {error}") from error


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a valid number")
