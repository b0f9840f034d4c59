"""Slot 6: every configured ROS node is alive, by all evidence that there is (docs/reference/ros.md)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from phm import api
from phm.api import Layer, Level, Slot
from phm_checks._graph_evidence import TWICE_S, GraphEvidence, NodeTopics
from phm_checks._liveness import Evidence, Kind, NodeHistory, NodeState, NodeVerdict, Observation, fuse
from phm_checks._process_matching import Wanted
from phm_checks._process_table import NEVER, ProcessTable
from phm_checks._text import brief, did_you_mean, last, span

OLD_PICTURE_S = 5.0
"""A picture of the graph older than this proves nothing."""
SLOW_S = 1.0
WITNESSES = 2
"""One node that is not heard may have lost its own way; when none of a container is, this many at least, it is the container's."""
BOTH_S = 2.0
"""A node that is started anew may overlap with the old one for a moment: two processes for longer are two nodes, or at once
where both are heard to beat."""
OVERLAP_S = 1.0
"""A container that takes another's place, as after an update, may overlap with it for so long."""
_Words = tuple[Level, str, str, str]
BUSY_S = 10.0
"""A node that computes and has not answered for this long is told as busy: a WARN, for nobody knows that it is wrong."""


class _Node:
    """What is remembered of one node. state: as judged last. seen: whether it was alive in this life of its container. known:
    in any life that PHM has seen."""

    def __init__(self, wanted: Wanted, signs: GraphEvidence) -> None:
        self.wanted, self.signs = wanted, signs
        self.state: NodeState | None = None
        self.seen = self.known = False
        self.copies = 0
        """Processes of its own, where more than one lasts: then it is known to run twice, whatever leases say."""
        self._both_since: float | None = None
        self._generation = ""

    @property
    def doubts(self) -> set[tuple[str, str]]:
        """Why it may not be well, with its name. What is told as bad is looked at until it is well."""
        well = self.state in (NodeState.ALIVE, None) or (self.state is NodeState.DUPLICATE and not self.copies)
        told = set() if well or self.state is None else {self.state.value}
        return {(self.wanted.name, why) for why in self.signs.doubts | told}

    def judge(
        self, evidence: Iterable[Evidence], began_at: float, now: float, grace_s: float, fit: int, *, unlisted: bool
    ) -> NodeVerdict:
        """fit: how many processes may be the node's own. While two that were told are there, the graph may be a new one that does
        not list both yet (`phm.probes.ros.stale_nodes`). unlisted: they cannot be listed."""
        both = fit > 1 and (self.signs.twofold or self.copies > 0)
        self._both_since = (self._both_since or now) if both else None
        lasts = self._both_since is not None and (self.signs.rivals > 0 or now - self._both_since >= BOTH_S)
        self.copies = fit if lasts else 0
        starting = now - began_at < grace_s
        past = NodeHistory(
            self.state is NodeState.ALIVE,
            self.seen,
            starting,
            self.copies > 0 or self.signs.twice(now),
            contained=bool(self.wanted.container),
            unlisted=unlisted,
        )
        judgement = fuse(evidence, past)
        self.state = judgement.state
        return judgement

    def live(self, roster: ProcessTable | None, evidence: Iterable[Evidence], now: float) -> None:
        """Note whether it was alive in this life of its container. A name alone may be a dead node's, until its lease ends; and
        who is heard in the first moment may be a node of the life before, which ends while this one begins."""
        generation, began_at = ("", NEVER) if roster is None else (roster.generation, roster.began_at(self.wanted.name))
        if generation != self._generation:
            self._generation, self.seen = generation, self.seen and not self._generation
        heard = any(
            piece.kind in (Kind.BEACON, Kind.TOPICS)
            and piece.says is Observation.ALIVE
            and now - piece.age_s > began_at + OVERLAP_S
            for piece in evidence
        )
        if (roster is not None and roster.lived(self.wanted.name)) or (
            self.state in (NodeState.ALIVE, NodeState.DUPLICATE)
            and (heard or self.signs.appeared_at > began_at or now - began_at > TWICE_S)
        ):
            self.seen = self.known = True


class Nodes(api.Check):
    """All configured nodes, one unit each, from one picture of the graph and the process lists of their containers."""

    name, slot, layer = "nodes", Slot.NODES, Layer.ROS
    period_s = 0.25

    def __init__(self, settings: api.Settings) -> None:
        self._grace_s = settings.ros.grace
        self._nodes: list[_Node] = []
        for entry in settings.ros.nodes:
            name = f"/{api.topic_id(entry.name)}"
            wanted = Wanted(name, settings.container_of_node(name), tuple(entry.process))
            self._nodes.append(
                _Node(wanted, GraphEvidence(name, NodeTopics.of(name, settings.ros.topics), self._grace_s))
            )
        self._rosters = {
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
            )
            for node in self._nodes
            for key in (node.wanted.container,)
        ]

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"ros", *(f"container:{key}" for key in self._rosters)})

    def run(self, world: api.World) -> Mapping[str, api.Result]:
        """A result for each node; STALE for those of which nothing can be told."""
        fact, why = _picture(world)
        now = world.clock.mono()
        signs = {node.wanted.name: self._signs(node, fact, now) for node in self._nodes}
        for roster in self._rosters.values():
            if world.clock.mono() - now > SLOW_S:
                break  # an engine that hangs takes its deadline for each question: the others are asked in the next run
            own = [node for node in self._nodes if node.wanted.container == roster.key]
            doubts = set().union(*(node.doubts for node in own))
            roster.look(world, doubts, blind=any(node.signs.blind for node in own))
        now = world.clock.mono()
        evidence = {node.wanted.name: self._evidence(node, signs[node.wanted.name], now) for node in self._nodes}
        cut_off = self._cut_off(evidence)
        return {
            node.wanted.unit: self._result(node, evidence[node.wanted.name], fact, why, now, cut_off=cut_off)
            for node in self._nodes
        }

    def _evidence(self, node: _Node, signs: Sequence[Evidence], now: float) -> list[Evidence]:
        roster = self._rosters.get(node.wanted.container)
        pieces = (roster.container(now), roster.process(node.wanted.name, now)) if roster is not None else ()
        return [*signs, *(piece for piece in pieces if piece is not None)]

    def _cut_off(self, evidence: Mapping[str, Sequence[Evidence]]) -> set[str]:
        """Containers of which no node is heard or listed though the processes of all of them run: it is the way to them."""
        containers = [node.wanted.container for node in self._nodes]
        unheard = [node.wanted.container for node in self._nodes if _unheard(evidence[node.wanted.name])]
        return {key for key in self._rosters if unheard.count(key) == containers.count(key) >= WITNESSES}

    def _signs(self, node: _Node, fact: api.RosFact | None, now: float) -> list[Evidence]:
        roster, name = self._rosters.get(node.wanted.container), node.wanted.name
        found = node.signs.look(fact, now, roster.began_at(name) if roster is not None else NEVER)
        if roster is not None:
            roster.forget(name, node.signs.appeared_at)
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
    ) -> api.Result:
        roster, name = self._rosters.get(node.wanted.container), node.wanted.name
        began_at, process, fit = NEVER, "", 0
        if roster is not None:
            began_at, process, fit = roster.began_at(name), roster.describe(name), roster.fit(name, now)
        unlisted = roster is not None and roster.unlisted
        judgement = node.judge(evidence, began_at, now, self._grace_s, fit, unlisted=unlisted)
        node.live(roster, evidence, now)
        level, words, short, condition = self._words(node, judgement, fact, why)
        values: dict[str, api.Value] = {"listed": node.signs.count, "process": process}
        known = api.Evidence(
            certain=judgement.state is NodeState.NEVER_STARTED and roster is not None and roster.left_out(name),
            conclusive=judgement.witnessed or judgement.state is NodeState.DUPLICATE,
            listed=node.signs.count,
        )
        if condition == "node_missing" and node.wanted.container in cut_off:
            return _unreached(node, judgement, values, known)
        target = node.wanted.container if level is Level.ERROR else ""
        return api.Result(
            level, words, brief(last(name), short) if short else "", condition, target, values, evidence=known
        )

    def _words(self, node: _Node, judgement: NodeVerdict, fact: api.RosFact | None, why: str) -> _Words:
        """Level, summary, the brief's end, and condition."""
        name, evidence = node.wanted.name, judgement.words
        subject, where = api.topic_id(name), f" in {node.wanted.container}" if node.wanted.container else ""
        state = judgement.state
        if state is NodeState.ALIVE and judgement.busy_s < BUSY_S:
            busy = f" and busy: {evidence}" if judgement.busy_s else ""
            return Level.OK, f"Node {subject} is running{busy}", "", ""
        if state is NodeState.ALIVE:
            words = (
                f"node {name} is busy and has not answered for {span(judgement.busy_s)}: {evidence}; look for an infinite loop "
                "or too much work in a callback"
            )
            return Level.WARN, words, "busy", "node_busy"
        if state is NodeState.DUPLICATE and node.copies:
            words = (
                f"node {name} runs twice{where}: {node.copies} processes match it, and it is listed {node.signs.count} times, expected "
                "once: two nodes with the same name conflict; stop the unintended one, or give "
                "each its own namespace"
            )
            return Level.ERROR, words, "runs twice", "node_duplicate"
        if state is NodeState.DUPLICATE:
            lasted = (
                "and two processes send beacons under its name"
                if node.signs.rivals
                else f"for more than {TWICE_S:.0f} s"
            )
            words = (
                f"node {name} is listed {node.signs.count} times {lasted}, expected once: two nodes with the same name conflict; stop "
                "one, or give each its own namespace"
            )
            return Level.WARN, words, "runs twice", "node_duplicate"
        if state is NodeState.UNKNOWN:
            looked = f"PHM has observed the graph for only {span(fact.up_s)}" if fact is not None else why
            words = f"not yet known whether node {name} is alive: {evidence or looked}"
            return Level.STALE, words, "", ""
        if state is NodeState.UNANSWERING:
            words = (
                f"node {name} does not answer{where}; it may be hung or busy: {evidence}. It was expected "
                "to answer: check its log and `docker top`; PHM restarts nothing for this"
            )
            return Level.ERROR, words, "does not answer", "node_unanswering"
        if state is NodeState.HUNG:
            words = f"Node {subject} is hung{where}: {evidence}. It was expected to answer: check its log, restart it"
            return Level.ERROR, words, "hung", "node_hung"
        dead = state is NodeState.DEAD
        what, step = _missing(node, dead=dead)
        words = (
            f"Not all required nodes are running. Missing node: {subject}; it {what}{where}: {evidence}. It was expected "
            f"to run: {step}.{did_you_mean(name, self._strangers(fact))}"
        )
        return Level.ERROR, words, "dead" if dead else "never started", "node_missing"

    def _strangers(self, fact: api.RosFact | None) -> list[str]:
        """Listed nodes that are not configured: only one of these can be the missing one under another name."""
        configured = {node.wanted.name for node in self._nodes}
        return [name for name in fact.nodes if name not in configured] if fact is not None else []


def _missing(node: _Node, *, dead: bool) -> tuple[str, str]:
    """What is said of a node that is not there, and what to do. A node that came with earlier lives of its container is
    configured well, and one that nobody knows may have another name."""
    if dead:
        return "is no longer running", "restart it and check its log"
    if node.known:
        return "was not started with its container", "restart it and check the log of its launcher"
    return (
        "has not been seen since PHM or its container started",
        "check its launch file, name, namespace and ROS_DOMAIN_ID",
    )


def _unheard(evidence: Iterable[Evidence]) -> bool:
    """Whether nothing is heard of a node and its name is not listed, while its process runs."""
    said = {piece.kind: piece.says for piece in evidence}
    return (
        said.get(Kind.PROCESS) in (Observation.ALIVE, Observation.BUSY)
        and said.get(Kind.NAME) is Observation.GONE
        and said.get(Kind.BEACON) in (None, Observation.SILENT)
        and said.get(Kind.TOPICS) in (None, Observation.SILENT)
    )


def _unreached(node: _Node, judgement: NodeVerdict, values: dict[str, api.Value], known: api.Evidence) -> api.Result:
    """No target: a restart does not open the way between PHM and a container."""
    name, where = node.wanted.name, node.wanted.container
    words = (
        f"nothing is received from node {name} or any other node of {where}, although all their processes are running: {judgement.words}. "
        f"They were expected in the graph: check the network between PHM and {where}, ROS_DOMAIN_ID, firewalls, discovery; "
        "PHM restarts nothing for this"
    )
    return api.Result(
        Level.ERROR, words, brief(last(name), "unreachable"), "node_unreachable", "", values, evidence=known
    )


def _picture(world: api.World) -> tuple[api.RosFact | None, str]:
    """The newest picture of the graph, or why there is none to judge by."""
    try:
        fact = world.ros.look()
    except api.CannotTell as reason:
        return None, str(reason)
    if fact.age_s > OLD_PICTURE_S:
        return None, f"the newest ROS graph snapshot is {span(fact.age_s)} old, too old to evaluate"
    return fact, ""
