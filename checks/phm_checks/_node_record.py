"""What the check `nodes` keeps about one node between runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm_checks._evidence import EvidencePiece, Kind, Observation
from phm_checks._graph_evidence import TWICE_S, GraphEvidence
from phm_checks._liveness import NodeHistory, NodeState, NodeVerdict, judge_node
from phm_checks._process_matching import Wanted
from phm_checks._process_table import NEVER, ProcessTable

BOTH_S = 2.0
"""Two processes of one node for longer than this are a duplicate; a restarted node may briefly overlap with the old one.
No wait is needed when both send beacons."""
OVERLAP_S = 1.0
"""The longest overlap of a container with the one that it replaces, e.g. after an update."""


class NodeRecord:
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
        self, evidence: Sequence[EvidencePiece], table: ProcessTable | None, now: float, grace_s: float
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

    def _record_hang(self, evidence: Iterable[EvidencePiece], process: tuple[str, int] | None, ran_s: float) -> None:
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

    def record_alive(self, table: ProcessTable | None, evidence: Iterable[EvidencePiece], now: float) -> None:
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
