"""Which process is which node: by the words of command lines. Pure.

What is not certain is not answered: two processes for one node, or one for two nodes, are nobody's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from phm import api

_NAMESPACE = re.compile(r"(?:__ns:=|--namespace[ =])/?([\w/]*)", re.ASCII)
_NAME = re.compile(r"__node:=(\w+)", re.ASCII)
_TOOL = re.compile(r"(?:^|[/ ])ros2 ")
_END = r"(?![\w.-])"
_STEPS = 64
"""Generations of parents followed; processes come from outside and may lie in a circle."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """One configured node. name: with its first slash. container: key, empty when not known. process: see NodeSettings."""

    name: str
    container: str = ""
    process: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        return f"nodes/{api.topic_id(self.name)}"

    @property
    def namespace(self) -> str:
        return api.topic_id(self.name).rpartition("/")[0]

    @property
    def short(self) -> str:
        return self.name.rpartition("/")[2]


@dataclass(frozen=True, slots=True)
class Match:
    """The process of a node, and those of its parents that have the same words (a shell, `ros2 run`, an init)."""

    process: api.ProcessFact
    wrappers: frozenset[int] = frozenset()


def match(
    nodes: Sequence[Wanted], processes: Sequence[api.ProcessFact], wrappers: Mapping[str, Collection[int]]
) -> tuple[dict[str, Match], dict[str, int]]:
    """The certain matches by node name, and how many processes fit each of the others.

    wrappers: by node name, processes that are known to only stand around the node's own.
    """
    found: dict[str, Match] = {}
    counts: dict[str, int] = {}
    for node in nodes:
        fitting = _fitting(node, [one for one in processes if one.pid not in wrappers.get(node.name, ())])
        inner = _inner(fitting, processes)
        counts[node.name] = len(inner)
        if len(inner) == 1:
            around = frozenset(one.pid for one in fitting if one.pid != inner[0].pid)
            found[node.name] = Match(inner[0], around)
    for name in _shared(nodes, found):
        del found[name]
    return found, {name: count for name, count in counts.items() if name not in found}


def _fitting(node: Wanted, processes: Sequence[api.ProcessFact]) -> list[api.ProcessFact]:
    """Those that fit by the first way that fits any: the user's words, a remapped name, an option, the bare name."""
    if node.process:
        return [one for one in processes if all(words in one.command for words in node.process)]
    own = [one for one in processes if _may_be(node, one.command)]
    for fits in _ways(node.short):
        found = [one for one in own if fits(one.command)]
        if found:
            return [one for one in found if _NAMESPACE.search(one.command)] or found
    return []


def _may_be(node: Wanted, command: str) -> bool:
    """Not if the command line gives its node another name or namespace, or is one of ROS's own tools, which name nodes."""
    spaces, names = _NAMESPACE.findall(command), _NAME.findall(command)
    return (
        (not spaces or node.namespace in [space.strip("/") for space in spaces])
        and (not names or node.short in names)
        and (bool(names) or not _TOOL.search(command))
    )


def _ways(short: str) -> Iterable[Callable[[str], object]]:
    name = re.escape(short)
    for pattern in (
        rf"__node:={name}{_END}",
        rf"--name[ =]{name}{_END}",
        rf"(?<![\w.-]){name}(?:\.py)?{_END}",  # not node_1.launch.py, which starts it and others
    ):
        yield re.compile(pattern, re.ASCII).search


def _inner(fitting: Sequence[api.ProcessFact], processes: Sequence[api.ProcessFact]) -> list[api.ProcessFact]:
    """Without those that are a parent of another: what starts a node often has the node's words, too."""
    parents = {one.pid: one.parent for one in processes}
    outer: set[int] = set()
    for one in fitting:
        pid = one.parent
        for _ in range(_STEPS):
            if pid not in parents:
                break
            outer.add(pid)
            pid = parents[pid]
    return [one for one in fitting if one.pid not in outer]


def _shared(nodes: Sequence[Wanted], found: Mapping[str, Match]) -> set[str]:
    """Nodes that share a process although nobody said so."""
    users: dict[int, list[Wanted]] = {}
    for node in nodes:
        if node.name in found:
            users.setdefault(found[node.name].process.pid, []).append(node)
    return {node.name for several in users.values() if len(several) > 1 for node in several if not node.process}
