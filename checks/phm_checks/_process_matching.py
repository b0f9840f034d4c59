"""Which process is which node: by the words of command lines. Pure.

What is not certain is not answered: two processes for one node, or one for two nodes, are nobody's.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from phm import api

_NAMESPACE = re.compile(r"(?:__ns:=|--namespace[ =])/?([\w/]*)", re.ASCII)
_NAME = re.compile(r"__node:=(\w+)", re.ASCII)
_TOOL = re.compile(r"(?:^|[/ ])ros2 ")
_END = r"(?![\w.-])"
BARE = 2
"""The last of the ways by which a process is known, and the least sure: the node's name is a word of its command."""
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
    """The process of a node, and its parents, which may have the same words (a shell, `ros2 run`, an init, a launcher).

    way: by which of the ways it was found, the surest is 0.
    """

    process: api.ProcessFact
    wrappers: frozenset[int] = frozenset()
    way: int = 0


def match(
    nodes: Sequence[Wanted],
    processes: Sequence[api.ProcessFact],
    wrappers: Mapping[str, Collection[int]],
    ways: Mapping[str, int] | None = None,
) -> tuple[dict[str, Match], dict[str, int]]:
    """The certain matches by node name, and how many processes fit each of the others.

    wrappers: by node name, processes that are known to only stand around the node's own. ways: by node name, how surely its
    process was known before: what fits less surely is not the node's.
    """
    found: dict[str, Match] = {}
    counts: dict[str, int] = {}
    parents = {one.pid: one.parent for one in processes}
    for node in nodes:
        apart = [one for one in processes if one.pid not in wrappers.get(node.name, ())]
        fitting, way = _fitting(node, apart, (ways or {}).get(node.name, BARE))
        outer = {pid for one in fitting for pid in _above(one.pid, parents)}
        inner = [one for one in fitting if one.pid not in outer]
        counts[node.name] = len(inner)
        if len(inner) == 1:
            found[node.name] = Match(inner[0], frozenset(_above(inner[0].pid, parents)), way)
    for name in _launchers(nodes, found):
        del found[name]
        counts[name] = 0
    for name in _shared(nodes, found):
        del found[name]
    return found, {name: count for name, count in counts.items() if name not in found}


def _fitting(node: Wanted, processes: Sequence[api.ProcessFact], least: int) -> tuple[list[api.ProcessFact], int]:
    """Those that fit by the first way that fits any (the user's words, a remapped name, an option, the bare name), and which."""
    if node.process:
        return [one for one in processes if all(words in one.command for words in node.process)], 0
    own = [one for one in processes if _may_be(node, one.command)]
    for way, fits in enumerate(_ways(node.short)[: least + 1]):
        found = [one for one in own if fits(one.command)]
        if found:
            return [one for one in found if _NAMESPACE.search(one.command)] or found, way
    return [], 0


def _may_be(node: Wanted, command: str) -> bool:
    """Not if the command line gives its node another name or namespace, or is one of ROS's own tools, which name nodes."""
    spaces, names = _NAMESPACE.findall(command), _NAME.findall(command)
    return (
        (not spaces or node.namespace in [space.strip("/") for space in spaces])
        and (not names or node.short in names)
        and (bool(names) or not _TOOL.search(command))
    )


def _ways(short: str) -> Sequence[Callable[[str], object]]:
    name = re.escape(short)
    patterns = (
        rf"__node:={name}{_END}",
        rf"--name[ =]{name}{_END}",
        rf"(?<![\w.-]){name}(?:\.py)?{_END}",  # not node_1.launch.py, which starts it and others
    )
    return [re.compile(pattern, re.ASCII).search for pattern in patterns]


def _above(pid: int, parents: Mapping[int, int]) -> set[int]:
    """All that stand around a process: what starts a node often has the node's words, too."""
    found: set[int] = set()
    for _ in range(_STEPS):
        pid = parents.get(pid, 0)
        if pid not in parents or pid in found:
            break
        found.add(pid)
    return found


def _launchers(nodes: Sequence[Wanted], found: Mapping[str, Match]) -> set[str]:
    """Nodes for which only the process that starts them was found: one that names another node, too, and has started it."""
    known = {node.name: node for node in nodes}
    return {
        name
        for name, own in found.items()
        if own.way == BARE
        and any(
            own.process.pid in other.wrappers and _ways(known[neighbour].short)[BARE](own.process.command)
            for neighbour, other in found.items()
            if neighbour != name
        )
    }


def _shared(nodes: Sequence[Wanted], found: Mapping[str, Match]) -> set[str]:
    """Nodes that share a process although nobody said so."""
    users: dict[int, list[Wanted]] = {}
    for node in nodes:
        if node.name in found:
            users.setdefault(found[node.name].process.pid, []).append(node)
    return {node.name for several in users.values() if len(several) > 1 for node in several if not node.process}
