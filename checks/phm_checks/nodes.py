"""Slot 6: each configured ROS node is alive, decided from all available evidence (docs/reference/ros.md)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._environment_advice import advice
from phm_checks._evidence import EvidencePiece, Kind, Observation
from phm_checks._graph_evidence import TWICE_S, GraphEvidence, NodeTopics
from phm_checks._liveness import HANG_S, LOST_S, NodeState, NodeVerdict, disproved
from phm_checks._node_record import NodeRecord
from phm_checks._process_matching import wanted_nodes
from phm_checks._process_table import NEVER, ProcessTable
from phm_checks._ros_facts import graph_snapshot
from phm_checks._text import brief, did_you_mean, last, span

SLOW_S = 1.0
WITNESSES = 2
"""At least this many nodes of a container, in as many processes, and all of them, must be unreachable before the container's network is
blamed. A single unreachable process may have its own problem."""
BUSY_S = 10.0
"""A node that uses the CPU and has not answered for this long is reported as busy. WARN only: it may be working normally."""


class _Text(NamedTuple):
    """`short`: end of the brief; empty: there is none."""

    level: Level
    summary: str
    short: str = ""
    condition: str = ""


_NOT_WORKING = {
    NodeState.UNANSWERING: _Text(
        Level.ERROR,
        "node {name} does not answer{where}; it may be hung or busy: {evidence}. It was expected "
        "to answer: check its log and `docker top`; PHM restarts nothing for this",
        "does not answer",
        "node_unanswering",
    ),
    NodeState.BLOCKED: _Text(
        Level.ERROR,
        "Node {subject} is blocked{where}: {evidence}. It was expected to run its callbacks: check its log; PHM restarts nothing "
        "for this before {hang_s:g} s",
        "blocked",
        "node_blocked",
    ),
    NodeState.HUNG: _Text(
        Level.ERROR,
        "Node {subject} is hung{where}: {evidence}. It was expected to answer: check its log, restart it",
        "hung",
        "node_hung",
    ),
}
"""By state, with the node's names and the evidence to be inserted."""


class Nodes(api.Check):
    """All configured nodes, one unit each, from one graph snapshot and the process lists of their containers."""

    name, slot, layer = "nodes", Slot.NODES, Layer.ROS
    period_s = 0.25

    def __init__(self, settings: api.Settings) -> None:
        self._grace_s = settings.ros.grace
        self._nodes: list[NodeRecord] = []
        for wanted in wanted_nodes(settings):
            topics = NodeTopics.of(wanted.name, settings.ros.topics)
            self._nodes.append(NodeRecord(wanted, GraphEvidence(wanted.name, topics, self._grace_s)))
        self._tables = {
            key: ProcessTable(key, [node.wanted for node in self._nodes if node.wanted.container == key], self._grace_s)
            for key in dict.fromkeys(node.wanted.container for node in self._nodes if node.wanted.container)
        }

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(settings)] if settings.ros.nodes else []

    @property
    def units(self) -> Sequence[api.Unit]:
        return [
            api.Unit(
                node.wanted.unit,
                needs=(f"container/{key}", f"network/{key}") if key else (),
                target=key,
                grace_s=self._grace_s,
                node=node.wanted.name,
            )
            for node in self._nodes
            for key in (node.wanted.container,)
        ]

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros", *(f"container:{key}" for key in self._tables)})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each node; STALE for a node without evidence."""
        fact, why = _snapshot(world)
        now = world.clock.mono()
        signs = {node.wanted.name: self._from_graph(node, fact, now) for node in self._nodes}
        for table in self._tables.values():
            if world.clock.mono() - now > SLOW_S:
                break  # each call to a hung engine takes its full deadline: the next run asks for the other containers
            own = [node for node in self._nodes if node.wanted.container == table.key]
            suspicions = set().union(*(node.suspicions for node in own))
            table.observe(world, suspicions, blind=any(node.graph.blind for node in own))
        now = world.clock.mono()
        evidence = {node.wanted.name: self._evidence(node, signs[node.wanted.name], now) for node in self._nodes}
        for name in [node.wanted.name for node in self._nodes if self._only_others_run(node, evidence)]:
            evidence[name] = [piece for piece in evidence[name] if piece.kind is not Kind.PROCESS]
        cut_off = self._cut_off(evidence)
        return {
            node.wanted.unit: self._result(
                node, evidence[node.wanted.name], fact, why, now, cut_off=cut_off, world=world
            )
            for node in self._nodes
        }

    def _evidence(self, node: NodeRecord, signs: Sequence[EvidencePiece], now: float) -> list[EvidencePiece]:
        table = self._tables.get(node.wanted.container)
        pieces = (table.container(now), table.process(node.wanted.name, now)) if table is not None else ()
        return [*signs, *(piece for piece in pieces if piece is not None)]

    def _only_others_run(self, node: NodeRecord, evidence: Mapping[str, Sequence[EvidencePiece]]) -> bool:
        """Whether the node's process is that of other nodes: it has left the graph, while another node of the process is listed, or sends
        and is not listed either for so long. A component may have been unloaded, or was never loaded."""
        name, table = node.wanted.name, self._tables.get(node.wanted.container)
        if table is None or not _unreachable(evidence[name]):
            return False
        gone_s = next(piece.lasted_s for piece in evidence[name] if piece.kind is Kind.NAME)
        kinds = (Kind.NAME, Kind.BEACON, Kind.TOPICS) if gone_s >= LOST_S else (Kind.NAME,)
        others = [one.wanted.name for one in self._nodes if one is not node and one.wanted.container == table.key]
        return any(
            piece.kind in kinds and piece.says is Observation.ALIVE
            for other in others
            if table.running(other) == table.running(name)
            for piece in evidence[other]
        )

    def _cut_off(self, evidence: Mapping[str, Sequence[EvidencePiece]]) -> set[str]:
        """Containers whose nodes are all unreachable although their processes run: the network to them is at fault."""
        return {key for key, table in self._tables.items() if self._all_unreachable(table, evidence)}

    def _all_unreachable(self, table: ProcessTable, evidence: Mapping[str, Sequence[EvidencePiece]]) -> bool:
        """Whether this holds for all nodes of one container. Nodes of one process are one witness."""
        names = [node.wanted.name for node in self._nodes if node.wanted.container == table.key]
        processes = {table.running(name) for name in names if _unreachable(evidence[name])}
        return len(processes) >= WITNESSES and all(_unreachable(evidence[name]) for name in names)

    def _from_graph(self, node: NodeRecord, fact: api.RosFact | None, now: float) -> list[EvidencePiece]:
        table, name = self._tables.get(node.wanted.container), node.wanted.name
        began_at = table.began_at(name) if table is not None else NEVER
        found = node.graph.observe(fact, now, began_at, same_process=node.still_hung(table))
        if table is not None:
            table.appeared(name, node.graph.appeared_at)
        return found

    def _result(
        self,
        node: NodeRecord,
        evidence: Sequence[EvidencePiece],
        fact: api.RosFact | None,
        why: str,
        now: float,
        *,
        cut_off: Collection[str],
        world: api.World,
    ) -> api.Result:
        table, name = self._tables.get(node.wanted.container), node.wanted.name
        process = table.describe(name) if table is not None else ""
        judgement = node.judge(evidence, table, now, self._grace_s)
        if table is not None and disproved(evidence):
            table.forget(name)
        node.record_alive(table, evidence, now)
        text = self._words(node, judgement, fact, why, world)
        values: dict[str, api.Value] = {"listed": node.graph.count, "process": process}
        known = api.Evidence(
            certain=judgement.certain
            or (judgement.state is NodeState.NEVER_STARTED and table is not None and table.not_started(name)),
            observed=now - judgement.age_s if judgement.certain else float("inf"),
            conclusive=judgement.witnessed or judgement.state is NodeState.DUPLICATE,
            listed=node.graph.count,
        )
        if text.condition == "node_missing" and node.wanted.container in cut_off:
            return _network_result(node, judgement, values, known, world)
        short = brief(last(name), text.short) if text.short else ""
        target = node.wanted.container if text.level is Level.ERROR else ""
        return api.Result(text.level, text.summary, short, text.condition, target, values, evidence=known)

    def _words(
        self, node: NodeRecord, judgement: NodeVerdict, fact: api.RosFact | None, why: str, world: api.World
    ) -> _Text:
        state = judgement.state
        if state is NodeState.ALIVE:
            return _alive_text(node.wanted.name, judgement)
        if state is NodeState.DUPLICATE:
            return _duplicate_text(node)
        if state is NodeState.UNKNOWN:
            return self._unknown_text(node, judgement, fact, why)
        if state in _NOT_WORKING:
            return _not_working_text(node, judgement)
        return self._missing_text(node, judgement, fact, world)

    def _unknown_text(self, node: NodeRecord, judgement: NodeVerdict, fact: api.RosFact | None, why: str) -> _Text:
        table = self._tables.get(node.wanted.container)
        looked = f"PHM has observed the graph for only {span(fact.up_s)}" if fact is not None else why
        was = "; it was hung, and has given no sign of life since" if node.still_hung(table) else ""
        words = f"not yet known whether node {node.wanted.name} is alive: {judgement.words or looked}{was}"
        return _Text(Level.STALE, words)

    def _missing_text(
        self, node: NodeRecord, judgement: NodeVerdict, fact: api.RosFact | None, world: api.World
    ) -> _Text:
        name, dead = node.wanted.name, judgement.state is NodeState.DEAD
        what, remedy = _missing(node, dead=dead)
        if not node.known and not self._any_listed(node.wanted.container):
            remedy = advice(world, node.wanted.container, remedy)
        words = (
            f"Not all required nodes are running. Missing node: {api.topic_id(name)}; it {what}{_where(node)}: {judgement.words}. "
            f"It was expected to run: {remedy}.{did_you_mean(name, self._unconfigured(fact))}"
        )
        return _Text(Level.ERROR, words, "dead" if dead else "never started", "node_missing")

    def _any_listed(self, container: str) -> bool:
        return any(node.graph.count for node in self._nodes if node.wanted.container == container)

    def _unconfigured(self, fact: api.RosFact | None) -> list[str]:
        """Listed nodes that are not configured: only one of these can be the missing node under another name."""
        configured = {node.wanted.name for node in self._nodes}
        return [name for name in fact.nodes if name not in configured] if fact is not None else []


def _where(node: NodeRecord) -> str:
    return f" in {node.wanted.container}" if node.wanted.container else ""


def _alive_text(name: str, judgement: NodeVerdict) -> _Text:
    evidence = judgement.words
    if judgement.busy_s < BUSY_S:
        busy = f" and busy: {evidence}" if judgement.busy_s else ""
        return _Text(Level.OK, f"Node {api.topic_id(name)} is running{busy}")
    words = (
        f"node {name} is busy and has not answered for {span(judgement.busy_s)}: {evidence}; look for an infinite loop "
        "or too much work in a callback"
    )
    return _Text(Level.WARN, words, "busy", "node_busy")


def _duplicate_text(node: NodeRecord) -> _Text:
    name, listed = node.wanted.name, node.graph.count
    if node.copies:
        words = (
            f"node {name} runs twice{_where(node)}: {node.copies} processes match it, and it is listed {listed} times, expected "
            "once: two nodes with the same name conflict; stop the unintended one, or give "
            "each its own namespace"
        )
        return _Text(Level.ERROR, words, "runs twice", "node_duplicate")
    lasted = "and two processes send beacons under its name" if node.graph.rivals else f"for more than {TWICE_S:.0f} s"
    words = (
        f"node {name} is listed {listed} times {lasted}, expected once: two nodes with the same name conflict; stop "
        "one, or give each its own namespace"
    )
    return _Text(Level.WARN, words, "runs twice", "node_duplicate")


def _not_working_text(node: NodeRecord, judgement: NodeVerdict) -> _Text:
    text, name = _NOT_WORKING[judgement.state], node.wanted.name
    words = text.summary.format(
        name=name, subject=api.topic_id(name), where=_where(node), evidence=judgement.words, hang_s=HANG_S
    )
    return text._replace(summary=words)


def _missing(node: NodeRecord, *, dead: bool) -> tuple[str, str]:
    """What the summary says of a missing node, and the remedy.

    A node that ran earlier is configured correctly; a node that PHM has never seen may have another name.
    """
    if dead:
        return "is no longer running", "restart it and check its log"
    if node.known:
        return "was not started with its container", "restart it and check the log of its launcher"
    return (
        "has not been seen since PHM or its container started",
        "check its launch file, name, namespace and ROS_DOMAIN_ID",
    )


def _unreachable(evidence: Iterable[EvidencePiece]) -> bool:
    """Whether the node's process runs, but nothing is received from it and its name is not listed."""
    said = {piece.kind: piece.says for piece in evidence}
    return (
        said.get(Kind.PROCESS) in (Observation.ALIVE, Observation.BUSY)
        and said.get(Kind.NAME) is Observation.GONE
        and said.get(Kind.BEACON) in (None, Observation.SILENT)
        and said.get(Kind.TOPICS) in (None, Observation.SILENT)
    )


def _network_result(
    node: NodeRecord, judgement: NodeVerdict, values: dict[str, api.Value], known: api.Evidence, world: api.World
) -> api.Result:
    """Result without a recovery target: a restart does not repair the network between PHM and a container."""
    name, where = node.wanted.name, node.wanted.container
    step = f"check the network between PHM and {where}, ROS_DOMAIN_ID, firewalls, discovery"
    words = (
        f"nothing is received from node {name} or any other node of {where}, although all their processes are running: {judgement.words}. "
        f"They were expected in the graph: {advice(world, where, step)}; PHM restarts nothing for this"
    )
    return api.Result(
        Level.ERROR, words, brief(last(name), "unreachable"), "node_unreachable", "", values, evidence=known
    )


def _snapshot(world: api.World) -> tuple[api.RosFact | None, str]:
    """The newest graph snapshot, or None and the reason why there is no usable one."""
    try:
        return graph_snapshot(world), ""
    except api.CannotTell as reason:
        return None, str(reason)
