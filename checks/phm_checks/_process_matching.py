"""Matches processes to nodes by the words in command lines. Pure.

An uncertain match is not reported: two processes for one node, or one process for two nodes, match no node.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from phm import api
from phm_checks._ros_facts import full_name

_NAMESPACE = re.compile(r"(?:__ns:=|--namespace[ =])/?([\w/]*)", re.ASCII)
_NAME = re.compile(r"__node:=(\w+)", re.ASCII)
_TOOL = re.compile(r"(?:^|[/ ])ros2 ")
_END = r"(?![\w.-])"
BARE = 2
"""The last and least certain of the matching methods: the node's name is a word in the process's command line."""
EXEC_S = 2.0
"""A forked process that is going to execute another program has done so at this age (`ps` reports whole seconds)."""
_STEPS = 64
"""Maximum number of parent generations to follow; process lists are external input and may contain a cycle."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """One configured node. name: with its leading slash. container: key, empty if unknown. process: see NodeSettings."""

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


def wanted_nodes(settings: api.Settings) -> list[Wanted]:
    """All configured nodes."""
    named = ((full_name(entry.name), entry) for entry in settings.ros.nodes)
    return [Wanted(name, settings.container_of_node(name), tuple(entry.process)) for name, entry in named]


@dataclass(frozen=True, slots=True)
class Match:
    """The process of a node, and its parents, whose command lines may contain the same words (a shell, `ros2 run`, an init, a launcher).

    way: the matching method that found it; 0 is the most certain.
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
    """The certain matches by node name, and for each other node the number of processes that fit.

    wrappers: by node name, processes that are known to be only parents of the node's own. ways: by node name, the method that
    matched its process before: a process that fits only by a less certain method is not the node's.
    """
    found: dict[str, Match] = {}
    counts: dict[str, int] = {}
    parents = {one.pid: one.parent for one in processes}
    for node in nodes:
        apart = [one for one in processes if one.pid not in wrappers.get(node.name, ())]
        own = _own(node, apart, parents, (ways or {}).get(node.name, BARE))
        counts[node.name] = len(own.processes)
        if len(own.processes) == 1 and own.settled:
            found[node.name] = Match(own.processes[0], frozenset(_above(own.processes[0].pid, parents)), own.way)
    for name in _launchers(nodes, found):
        del found[name]
        counts[name] = 0
    for name in _shared(nodes, found):
        del found[name]
    return found, {name: count for name, count in counts.items() if name not in found}


def repeated(
    nodes: Sequence[Wanted], processes: Sequence[api.ProcessFact], found: Mapping[str, Match]
) -> dict[str, list[api.ProcessFact]]:
    """The processes of each node that seems to run more than once: enough for a statement that holds for all of them.

    found: the certain matches. Their processes are those of no other node, whose name may be a word in their command lines.
    """
    taken = {one.process.pid for one in found.values()}
    parents = {one.pid: one.parent for one in processes}
    free = [one for one in processes if one.pid not in taken]
    every = {node.name: _own(node, free, parents, BARE) for node in nodes if node.name not in found}
    return {name: own.processes for name, own in every.items() if own.settled and len(own.processes) > 1}


class _Own(NamedTuple):
    """The processes that fit a node, without the parents of others, and the method. settled: none may soon become another program."""

    processes: list[api.ProcessFact]
    way: int
    settled: bool = True


def _own(node: Wanted, processes: Sequence[api.ProcessFact], parents: Mapping[int, int], least: int) -> _Own:
    fitting, way = _fitting(node, processes, least)
    forks = _forks(fitting)
    if any(one.age_s is not None and one.age_s < EXEC_S for one in forks):
        return _Own(fitting, way, settled=False)
    apart = [one for one in fitting if one not in forks]
    outer = {pid for one in apart for pid in _above(one.pid, parents)}
    return _Own([one for one in apart if one.pid not in outer], way)


def _fitting(node: Wanted, processes: Sequence[api.ProcessFact], least: int) -> tuple[list[api.ProcessFact], int]:
    """The processes that fit by the first successful method (configured words, remapped name, option, bare name), and that method."""
    if node.process:
        return [one for one in processes if all(words in one.command for words in node.process)], 0
    own = [one for one in processes if _may_be(node, one.command)]
    for way, fits in enumerate(_ways(node.short)[: least + 1]):
        found = [one for one in own if fits(one.command)]
        if found:
            return [one for one in found if _NAMESPACE.search(one.command)] or found, way
    return [], 0


def _forks(processes: Sequence[api.ProcessFact]) -> list[api.ProcessFact]:
    """Those with the command line of their parent: it forked them. They are its workers (a pool of Python's `multiprocessing`), or
    about to execute another program, which a young one does not show."""
    by_pid = {one.pid: one for one in processes}
    return [one for one in processes if one.parent in by_pid and by_pid[one.parent].command == one.command]


def _may_be(node: Wanted, command: str) -> bool:
    """Whether the command may run the node: not if it sets another node name or namespace, or is a ROS tool, which also names nodes."""
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
        rf"(?<![\w.-]){name}(?:\.py)?{_END}",  # not node_1.launch.py, which starts this node and others
    )
    return [re.compile(pattern, re.ASCII).search for pattern in patterns]


def _above(pid: int, parents: Mapping[int, int]) -> set[int]:
    """All ancestors of a process: the command line of a node's launcher often contains the node's words, too."""
    found: set[int] = set()
    for _ in range(_STEPS):
        pid = parents.get(pid, 0)
        if pid not in parents or pid in found:
            break
        found.add(pid)
    return found


def _launchers(nodes: Sequence[Wanted], found: Mapping[str, Match]) -> set[str]:
    """Nodes for which only their launcher was found: a process that also names another node and has started it."""
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
    """Nodes that share a process although it is not configured for them."""
    users: dict[int, list[Wanted]] = {}
    for node in nodes:
        if node.name in found:
            users.setdefault(found[node.name].process.pid, []).append(node)
    return {node.name for several in users.values() if len(several) > 1 for node in several if not node.process}
