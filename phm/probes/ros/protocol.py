"""What the daemon and its ROS child say to each other: one JSON object a line, over pipes.

The daemon writes one line, what it wants to know (`Wanted`), then `Publish` as often as it likes, and in the end closes
the pipe. The child writes `Picture` when something changed and at least once a second, `Tick` in between, `Heard` when
beacons or diagnostics came, `Others` when unconfigured topics came or went, `Remark` for the log, and
`Missing` once when there is no ROS to look at, and first of all `Sandbox`. This module is imported by the child: standard library and facts only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NoReturn

from phm.facts.ros import BeaconFact, DiagnosticFact, NameFact, TopicFact
from phm.probes.ros.fact_codec import pack, value

LINE_LIMIT = 1_000_000
"""Longest line in bytes; a picture of 200 topics with 10 endpoints each is about 200 kB."""

INSTALLS = "PHM_ROS_INSTALLS"
"""Variable of the child's environment with the folders of `ros.installs`, separated as in PATH."""

EXIT_MISSING = 69
"""The child's exit code for `there is no ROS here` (EX_UNAVAILABLE of sysexits.h)."""


class ProtocolError(ValueError):
    """A line that is not a message: library output that strayed, or a line cut by a crash."""


@dataclass(frozen=True, slots=True)
class WantedTopic:
    """rate_hz: expected; 0 is a latched topic, None is not looked at. silence_s: see RosSettings.silence."""

    name: str
    rate_hz: float | None = None
    silence_s: float = 3.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the child is to look at. domain: None leaves it to ROS_DOMAIN_ID. tick_s: between two looks.

    listen: topics of diagnostic_msgs/DiagnosticArray to read. nodes: full names of those that are configured, as
    nodes or as ends of topics. watch: patterns of the statuses that are configured.
    """

    agent: str
    domain: int | None = None
    topics: tuple[WantedTopic, ...] = ()
    tick_s: float = 0.25
    full_s: float = 1.0
    listen: tuple[str, ...] = ()
    nodes: tuple[str, ...] = ()
    watch: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """The graph as it is now. up_s: how long the child's participant has existed. number: counts pictures of this child. late_s: by
    how much the child looked too late, because it did not get to run.

    names_known: whether the names of nodes could be read. problems: sentences about what could not be read or was left out.
    """

    up_s: float
    nodes: Mapping[str, int] = field(default_factory=dict)
    topics: Mapping[str, TopicFact] = field(default_factory=dict)
    number: int = 0
    names_known: bool = True
    problems: tuple[str, ...] = ()
    late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Tick:
    """Nothing changed since the last picture but these: seconds of silence of the topics with a rate.

    picture: the number of that picture. If it never arrived, nothing is known of the graph. late_s: as in `Picture`.
    """

    up_s: float
    silent_s: Mapping[str, float | None] = field(default_factory=dict)
    picture: int = 0
    late_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Heard:
    """What the application reported of itself since the last message of this kind; silent nodes are left out.

    ages: of beacons about which there is nothing else that is new. refused: see RosFact, so far. lost: more beacons came
    than are read.
    """

    beacons: Mapping[str, BeaconFact] = field(default_factory=dict)
    diagnostics: Mapping[str, DiagnosticFact] = field(default_factory=dict)
    ages: Mapping[str, float] = field(default_factory=dict)
    refused: int = 0
    lost: bool = False


@dataclass(frozen=True, slots=True)
class Others:
    """All topics, up to a cap, that are not in `Wanted.topics`, by full name."""

    names: Mapping[str, NameFact] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Remark:
    """A sentence for the log."""

    text: str


@dataclass(frozen=True, slots=True)
class Missing:
    """There is no usable rclpy. module: what could not be imported. detail: the import's own words."""

    module: str
    detail: str


@dataclass(frozen=True, slots=True)
class Sandbox:
    """The child has restricted itself (`phm.probes.ros.sandbox`). missing: what the kernel does not offer; empty: nothing."""

    missing: str = ""


@dataclass(frozen=True, slots=True)
class Publish:
    """From the daemon: publish this on /diagnostics, now. utc_s: the array's stamp. statuses: by name; ages mean nothing."""

    utc_s: float
    statuses: Mapping[str, DiagnosticFact] = field(default_factory=dict)


Message = Picture | Tick | Heard | Others | Remark | Missing | Sandbox

_KINDS: Mapping[str, type[Message]] = {
    "picture": Picture,
    "tick": Tick,
    "heard": Heard,
    "others": Others,
    "remark": Remark,
    "missing": Missing,
    "sandbox": Sandbox,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def encode_wanted(wanted: Wanted) -> bytes:
    return _line(asdict(wanted))


def decode_wanted(line: bytes | str) -> Wanted:
    """Raises ProtocolError."""
    try:
        data = _parsed(line)
        topics = tuple(WantedTopic(**topic) for topic in data.pop("topics"))
        listen, nodes, watch = (tuple(data.pop(name)) for name in ("listen", "nodes", "watch"))
        return Wanted(topics=topics, listen=listen, nodes=nodes, watch=watch, **data)
    except (AttributeError, KeyError, TypeError) as error:
        raise ProtocolError(f"not a configuration: {error}") from error


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
    return json.dumps(data, separators=(",", ":")).encode() + b"\n"


def _parsed(line: bytes | str) -> Any:
    try:
        return json.loads(line, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"not JSON: {error}") from error


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a valid number")
