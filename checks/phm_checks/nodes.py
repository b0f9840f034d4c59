"""Slot 6: each configured ROS node is alive, decided from all available evidence (docs/reference/ros.md)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._environment_advice import advice
from phm_checks._evidence import Evidence, Kind, Observation
from phm_checks._graph_evidence import TWICE_S, GraphEvidence, NodeTopics
from phm_checks._liveness import HANG_S, LOST_S, NodeHistory, NodeState, NodeVerdict, disproved, judge_node
from phm_checks._process_matching import Wanted, wanted_nodes
from phm_checks._process_table import NEVER, ProcessTable
from phm_checks._ros_facts import graph_snapshot
from phm_checks._text import brief, did_you_mean, last, span

SLOW_S = 1.0
WITNESSES = 2
"""At least this many nodes of a container, in as many processes, and all of them, must be unreachable before the container's network is
blamed. A single unreachable process may have its own problem."""
BOTH_S = 2.0
"""Two processes of one node for longer than this are a duplicate; a restarted node may briefly overlap with the old one.
No wait is needed when both send beacons."""
OVERLAP_S = 1.0
"""The longest overlap of a container with the one that it replaces, e.g. after an update."""
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


class _Node:
    """State of one node between runs. `state`: the last result; `seen`: whether it was alive since its container started;
    `known`: whether it was alive since PHM started."""

    def __init__(self, wanted: Wanted, graph: GraphEvidence) -> None:
        self.wanted, self.graph = wanted, graph
        self.state: NodeState | None = None
        self.seen = self.known = False
        self.copies = 0
        """Number of its processes if there is more than one for a while, else 0. Above 0 the node certainly runs twice,
        regardless of discovery leases."""
        self._hung_as: tuple[str, int] | None = None
        """Its process, if that was hung according to its beacon, and nothing has been received from the node since."""
        self._both_since: float | None = None
        self._generation = ""

    @property
    def suspicions(self) -> set[tuple[str, str]]:
        """The node's name with each reason to look at its processes. A node reported as bad keeps a reason until it is OK."""
        healthy = self.state in (NodeState.ALIVE, None) or (self.state is NodeState.DUPLICATE and not self.copies)
        reported = set() if healthy or self.state is None else {self.state.value}
        return {(self.wanted.name, why) for why in self.graph.suspicions | reported}

    def still_hung(self, table: ProcessTable | None) -> bool:
        """Whether it was hung, and nothing has shown since that it runs: neither a sign of life nor another process."""
        return self._hung_as is not None and table is not None and table.running(self.wanted.name) == self._hung_as

    def judge(
        self, evidence: Sequence[Evidence], table: ProcessTable | None, now: float, grace_s: float
    ) -> NodeVerdict:
        """Combine the evidence.

        Once two processes were reported, the node stays a duplicate while both exist: a new graph may not list both yet
        (`phm.probes.ros.stale_nodes`).
        """
        name = self.wanted.name
        began_at = NEVER if table is None else table.began_at(name)
        fit = 0 if table is None else table.fit(name, now)
        both = fit > 1 and (self.graph.duplicated or self.copies > 0)
        self._both_since = (self._both_since or now) if both else None
        lasts = self._both_since is not None and (self.graph.rivals > 0 or now - self._both_since >= BOTH_S)
        self.copies = fit if lasts else 0
        starting = now - began_at < grace_s
        past = NodeHistory(
            self.state is NodeState.ALIVE,
            self.seen,
            starting,
            self.copies > 0 or self.graph.twice(now),
            contained=bool(self.wanted.container),
            unlisted=table is not None and table.unlisted,
            hung=self.still_hung(table),
        )
        judgement = judge_node(evidence, past)
        self.state = judgement.state
        self._record_hang(evidence, None if table is None else table.running(name), now - began_at)
        return judgement

    def _record_hang(self, evidence: Iterable[Evidence], process: tuple[str, int] | None, ran_s: float) -> None:
        """Only a hang that the beacon shows: a process that was stopped and is resumed may have nothing to send. `ran_s`: how long the
        process has run at most; a longer silence is that of an earlier one."""
        said = {(piece.kind, piece.says): piece for piece in evidence}
        if (Kind.BEACON, Observation.ALIVE) in said or (Kind.TOPICS, Observation.ALIVE) in said:
            self._hung_as = None
            return
        stopped = said.get((Kind.BEACON, Observation.SILENT)) or said.get((Kind.BEACON, Observation.LATE))
        if (
            self.state in (NodeState.BLOCKED, NodeState.HUNG, NodeState.UNANSWERING)
            and stopped is not None
            and stopped.lasted_s < ran_s
        ):
            self._hung_as = process

    def record_alive(self, table: ProcessTable | None, evidence: Iterable[Evidence], now: float) -> None:
        """Record whether the node was alive since its container started.

        A name in the graph is not sufficient: it may belong to a dead node whose lease has not ended. Data received in the
        first moment may come from the previous run of the container, which ends while this one begins.
        """
        generation, began_at = ("", NEVER) if table is None else (table.generation, table.began_at(self.wanted.name))
        if generation != self._generation:
            self._generation, self.seen = generation, self.seen and not self._generation
        received = any(
            piece.kind in (Kind.BEACON, Kind.TOPICS)
            and piece.says is Observation.ALIVE
            and now - piece.age_s > began_at + OVERLAP_S
            for piece in evidence
        )
        if (table is not None and table.was_alive(self.wanted.name)) or (
            self.state in (NodeState.ALIVE, NodeState.DUPLICATE)
            and (received or self.graph.appeared_at > began_at or now - began_at > TWICE_S)
        ):
            self.seen = self.known = True


class Nodes(api.Check):
    """All configured nodes, one unit each, from one graph snapshot and the process lists of their containers."""

    name, slot, layer = "nodes", Slot.NODES, Layer.ROS
    period_s = 0.25

    def __init__(self, settings: api.Settings) -> None:
        self._grace_s = settings.ros.grace
        self._nodes: list[_Node] = []
        for wanted in wanted_nodes(settings):
            topics = NodeTopics.of(wanted.name, settings.ros.topics)
            self._nodes.append(_Node(wanted, GraphEvidence(wanted.name, topics, self._grace_s)))
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

    def _evidence(self, node: _Node, signs: Sequence[Evidence], now: float) -> list[Evidence]:
        table = self._tables.get(node.wanted.container)
        pieces = (table.container(now), table.process(node.wanted.name, now)) if table is not None else ()
        return [*signs, *(piece for piece in pieces if piece is not None)]

    def _only_others_run(self, node: _Node, evidence: Mapping[str, Sequence[Evidence]]) -> bool:
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

    def _cut_off(self, evidence: Mapping[str, Sequence[Evidence]]) -> set[str]:
        """Containers whose nodes are all unreachable although their processes run: the network to them is at fault."""
        return {key for key, table in self._tables.items() if self._all_unreachable(table, evidence)}

    def _all_unreachable(self, table: ProcessTable, evidence: Mapping[str, Sequence[Evidence]]) -> bool:
        """Whether this holds for all nodes of one container. Nodes of one process are one witness."""
        names = [node.wanted.name for node in self._nodes if node.wanted.container == table.key]
        processes = {table.running(name) for name in names if _unreachable(evidence[name])}
        return len(processes) >= WITNESSES and all(_unreachable(evidence[name]) for name in names)

    def _from_graph(self, node: _Node, fact: api.RosFact | None, now: float) -> list[Evidence]:
        table, name = self._tables.get(node.wanted.container), node.wanted.name
        began_at = table.began_at(name) if table is not None else NEVER
        found = node.graph.observe(fact, now, began_at, same_process=node.still_hung(table))
        if table is not None:
            table.appeared(name, node.graph.appeared_at)
        return found

    def _result(
        self,
        node: _Node,
        evidence: Sequence[Evidence],
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
        self, node: _Node, judgement: NodeVerdict, fact: api.RosFact | None, why: str, world: api.World
    ) -> _Text:
        name, evidence = node.wanted.name, judgement.words
        subject, where = api.topic_id(name), f" in {node.wanted.container}" if node.wanted.container else ""
        state = judgement.state
        if state is NodeState.ALIVE and judgement.busy_s < BUSY_S:
            busy = f" and busy: {evidence}" if judgement.busy_s else ""
            return _Text(Level.OK, f"Node {subject} is running{busy}")
        if state is NodeState.ALIVE:
            words = (
                f"node {name} is busy and has not answered for {span(judgement.busy_s)}: {evidence}; look for an infinite loop "
                "or too much work in a callback"
            )
            return _Text(Level.WARN, words, "busy", "node_busy")
        if state is NodeState.DUPLICATE and node.copies:
            words = (
                f"node {name} runs twice{where}: {node.copies} processes match it, and it is listed {node.graph.count} times, expected "
                "once: two nodes with the same name conflict; stop the unintended one, or give "
                "each its own namespace"
            )
            return _Text(Level.ERROR, words, "runs twice", "node_duplicate")
        if state is NodeState.DUPLICATE:
            lasted = (
                "and two processes send beacons under its name"
                if node.graph.rivals
                else f"for more than {TWICE_S:.0f} s"
            )
            words = (
                f"node {name} is listed {node.graph.count} times {lasted}, expected once: two nodes with the same name conflict; stop "
                "one, or give each its own namespace"
            )
            return _Text(Level.WARN, words, "runs twice", "node_duplicate")
        if state is NodeState.UNKNOWN:
            table = self._tables.get(node.wanted.container)
            looked = f"PHM has observed the graph for only {span(fact.up_s)}" if fact is not None else why
            was = "; it was hung, and has given no sign of life since" if node.still_hung(table) else ""
            words = f"not yet known whether node {name} is alive: {evidence or looked}{was}"
            return _Text(Level.STALE, words)
        if state in _NOT_WORKING:
            text = _NOT_WORKING[state]
            words = text.summary.format(name=name, subject=subject, where=where, evidence=evidence, hang_s=HANG_S)
            return text._replace(summary=words)
        dead = state is NodeState.DEAD
        what, remedy = _missing(node, dead=dead)
        if not node.known and not self._any_listed(node.wanted.container):
            remedy = advice(world, node.wanted.container, remedy)
        words = (
            f"Not all required nodes are running. Missing node: {subject}; it {what}{where}: {evidence}. It was expected "
            f"to run: {remedy}.{did_you_mean(name, self._unconfigured(fact))}"
        )
        return _Text(Level.ERROR, words, "dead" if dead else "never started", "node_missing")

    def _any_listed(self, container: str) -> bool:
        return any(node.graph.count for node in self._nodes if node.wanted.container == container)

    def _unconfigured(self, fact: api.RosFact | None) -> list[str]:
        """Listed nodes that are not configured: only one of these can be the missing node under another name."""
        configured = {node.wanted.name for node in self._nodes}
        return [name for name in fact.nodes if name not in configured] if fact is not None else []


def _missing(node: _Node, *, dead: bool) -> tuple[str, str]:
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


def _unreachable(evidence: Iterable[Evidence]) -> bool:
    """Whether the node's process runs, but nothing is received from it and its name is not listed."""
    said = {piece.kind: piece.says for piece in evidence}
    return (
        said.get(Kind.PROCESS) in (Observation.ALIVE, Observation.BUSY)
        and said.get(Kind.NAME) is Observation.GONE
        and said.get(Kind.BEACON) in (None, Observation.SILENT)
        and said.get(Kind.TOPICS) in (None, Observation.SILENT)
    )


def _network_result(
    node: _Node, judgement: NodeVerdict, values: dict[str, api.Value], known: api.Evidence, world: api.World
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
