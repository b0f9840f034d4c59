"""What the daemon and its ROS child say to each other: one JSON object a line, over pipes.

The daemon writes one line, what it wants to know (`Wanted`), and then only closes the pipe. The child
writes `Picture` when something changed and at least once a second, `Tick` in between, and `Missing` once
when there is no ROS to look at. This module is imported by the child: standard library and facts only.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NoReturn

from phm.facts import EndpointFact, RateFact, TopicFact

LINE_LIMIT = 1_000_000
"""Longest line in bytes; a picture of 200 topics with 10 endpoints each is about 200 kB."""

EXIT_MISSING = 69
"""The child's exit code for `there is no ROS here` (EX_UNAVAILABLE of sysexits.h)."""


class ProtocolError(ValueError):
    """A line that is no message: library output that strayed, or a line cut by a crash."""


@dataclass(frozen=True, slots=True)
class WantedTopic:
    """rate_hz: expected; None or 0 means that the rate is not measured. silence_s: see RosSettings.silence."""

    name: str
    rate_hz: float | None = None
    silence_s: float = 3.0


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the child is to look at. domain: None leaves it to ROS_DOMAIN_ID. tick_s: between two looks."""

    agent: str
    domain: int | None = None
    topics: tuple[WantedTopic, ...] = ()
    tick_s: float = 0.25
    full_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Picture:
    """The graph as it is now. up_s: how long the child's participant has existed."""

    up_s: float
    nodes: Mapping[str, int] = field(default_factory=dict)
    topics: Mapping[str, TopicFact] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Tick:
    """Nothing changed since the last picture but these: seconds of silence of the topics with a rate."""

    up_s: float
    silent_s: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Missing:
    """There is no usable rclpy. module: what could not be imported. detail: the import's own words."""

    module: str
    detail: str


Message = Picture | Tick | Missing


def encode_wanted(wanted: Wanted) -> bytes:
    return _line(asdict(wanted))


def decode_wanted(line: bytes | str) -> Wanted:
    """Raises ProtocolError."""
    try:
        data = _object(line)
        topics = tuple(WantedTopic(**topic) for topic in data.pop("topics"))
        return Wanted(topics=topics, **data)
    except (KeyError, TypeError) as error:
        raise ProtocolError(f"not a configuration: {error}") from error


def encode(message: Message) -> bytes:
    if isinstance(message, Tick):
        return _line({"kind": "tick", "up_s": message.up_s, "silent_s": dict(message.silent_s)})
    if isinstance(message, Missing):
        return _line({"kind": "missing", "module": message.module, "detail": message.detail})
    topics = {name: _topic(fact) for name, fact in message.topics.items()}
    return _line({"kind": "picture", "up_s": message.up_s, "nodes": dict(message.nodes), "topics": topics})


def decode(line: bytes | str) -> Message:
    """Raises ProtocolError for anything that `encode` did not write."""
    data = _object(line)
    try:
        kind = data["kind"]
        if kind == "tick":
            return Tick(float(data["up_s"]), {str(k): _maybe(v) for k, v in data["silent_s"].items()})
        if kind == "missing":
            return Missing(str(data["module"]), str(data["detail"]))
        if kind == "picture":
            nodes = {str(name): int(count) for name, count in data["nodes"].items()}
            topics = {str(name): _topic_fact(topic) for name, topic in data["topics"].items()}
            return Picture(float(data["up_s"]), nodes, topics)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"not a message: {error!r}") from error
    raise ProtocolError(f"unknown kind of message {kind!r}")


def _line(data: Mapping[str, Any]) -> bytes:
    return json.dumps(data, separators=(",", ":")).encode() + b"\n"


def _object(line: bytes | str) -> dict[str, Any]:
    try:
        data = json.loads(line, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"not JSON: {error}") from error
    if not isinstance(data, dict):
        raise ProtocolError("not a JSON object")
    return data


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of ours")


def _maybe(value: Any) -> float | None:
    return None if value is None else float(value)


def _topic(fact: TopicFact) -> dict[str, Any]:
    rate = fact.rate
    return {
        "pub": [[e.node, e.type, e.reliability, e.durability] for e in fact.publishers],
        "sub": [[e.node, e.type, e.reliability, e.durability] for e in fact.subscribers],
        "rate": rate and [rate.hz, rate.silent_s, rate.window_s, rate.samples, rate.problem],
    }


def _topic_fact(data: Mapping[str, Any]) -> TopicFact:
    rate = None
    if data["rate"] is not None:
        hz, silent_s, window_s, samples, problem = data["rate"]
        rate = RateFact(_maybe(hz), _maybe(silent_s), float(window_s), int(samples), str(problem))
    return TopicFact(_endpoints(data["pub"]), _endpoints(data["sub"]), rate)


def _endpoints(data: Any) -> tuple[EndpointFact, ...]:
    return tuple(
        EndpointFact(str(node), str(kind), str(reliability), str(durability))
        for node, kind, reliability, durability in data
    )
