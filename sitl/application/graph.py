"""The node graph of an agent's application: which nodes there are, what they publish and what they listen to."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

MOST_NODES = 64
OPTIONS_VARIABLE = "SITL_NODE"
"""As `sitl.application.node` has it, which imports nothing of this package so that it runs in any ROS image."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*\Z")


@dataclass(frozen=True)
class NodePlan:
    """publish: topics with their rates in Hz. Names are below the agent's namespace."""

    name: str
    publish: Mapping[str, float] = field(default_factory=dict)
    subscribe: Sequence[str] = ()

    def argv(self) -> list[str]:
        """The options of `sitl.application.node` for it."""
        words = ["--name", self.name]
        for topic, rate_hz in self.publish.items():
            words += ["--publish", f"{topic}:{rate_hz:g}"]
        for topic in self.subscribe:
            words += ["--subscribe", topic]
        return words

    def as_words(self) -> dict[str, Any]:
        return {"name": self.name, "publish": dict(self.publish), "subscribe": list(self.subscribe)}


def ring(nodes: int, rate_hz: float) -> list[NodePlan]:
    """Node i publishes topic_i and listens to the one before it, the first to the last."""
    return [
        NodePlan(f"node_{number}", {f"topic_{number}": rate_hz}, [f"topic_{(number - 2) % nodes + 1}"])
        for number in range(1, nodes + 1)
    ]


def read(found: Any) -> list[NodePlan]:
    """A list of ``{name: camera, publish: {image: 5}, subscribe: [command]}``, as YAML or JSON has it.

    ValueError names the entry and what is allowed.
    """
    entries = found.get("nodes") if isinstance(found, Mapping) else found
    if not isinstance(entries, list) or not 1 <= len(entries) <= MOST_NODES:
        raise ValueError(
            f"a node graph is a list of 1 to {MOST_NODES} nodes under the key `nodes`, found {entries!r:.80}"
        )
    plans = [_read_node(number, entry) for number, entry in enumerate(entries, 1)]
    names = [plan.name for plan in plans]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"node names must differ, found twice: {', '.join(twice)}")
    return plans


def _read_node(number: int, entry: Any) -> NodePlan:
    where = f"node {number} of the graph"
    if not isinstance(entry, Mapping) or set(entry) - {"name", "publish", "subscribe"}:
        raise ValueError(f"{where}: allowed are the keys name, publish and subscribe, found {entry!r:.80}")
    name, publish, subscribe = entry.get("name"), entry.get("publish") or {}, entry.get("subscribe") or []
    if not isinstance(publish, Mapping) or not isinstance(subscribe, list):
        raise ValueError(f"{where}: publish is a map of topics to rates in Hz, subscribe a list of topics")
    if isinstance(name, str) and "/" in name:
        raise ValueError(f"{where}: {name!r} has a '/'; all nodes are in the agent's own namespace")
    for word in (name, *publish, *subscribe):
        if not isinstance(word, str) or not _NAME.match(word):
            raise ValueError(
                f"{where}: {word!r} is not a name: letters, digits and '_', the first a letter, '/' between"
            )
    if not publish:
        raise ValueError(f"{where}: {name} publishes nothing; PHM could not tell a hung node from a healthy one")
    for topic, rate_hz in publish.items():
        if isinstance(rate_hz, bool) or not isinstance(rate_hz, int | float) or not 0.1 <= rate_hz <= 1000:
            raise ValueError(f"{where}: the rate of {topic} is {rate_hz!r}: allowed is 0.1 to 1000 Hz")
    return NodePlan(str(name), {topic: float(rate_hz) for topic, rate_hz in publish.items()}, list(subscribe))
