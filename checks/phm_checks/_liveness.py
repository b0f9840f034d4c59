"""Whether a node is alive, from all evidence about it: the evidence fusion. Pure; it makes no queries and keeps no state.

There are six kinds of evidence, the most reliable first. The first rule that reaches a verdict decides. So strong evidence is reported
immediately, and weak evidence of death never overrides a newer sign of life.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from phm_checks._evidence import EvidencePiece, Kind, Observation


class NodeState(Enum):
    ALIVE = "alive"
    HUNG = "hung"
    BLOCKED = "blocked"
    """Its executor does not run and its topics are silent for longer than ever, but not yet for as long as a slow callback may take."""
    UNANSWERING = "unanswering"
    """It is hung or busy: its process could show which, but too little is known about that process."""
    DEAD = "dead"
    NEVER_STARTED = "never started"
    DUPLICATE = "duplicate"
    UNKNOWN = "unknown"


HANG_S = 5.0
"""An executor that has not run for this long is hung if its process does not use the CPU. A shorter time could be a slow callback."""
BLIND_HANG_S = 15.0
"""The same if it is unknown whether the process uses the CPU."""
MUTE_S = 8.0
"""The same if its process cannot be listed, and it sends neither beacons nor data: the fault is then the node's, and its topics, which
wait up to 12 s for it (`phm.tracker.rules`), have none. Nothing is restarted, since it may be busy."""
CERTAIN_HANG_S = 15.0
"""A lack of CPU does not block an executor for this long while the beacon of the same process is on time: with 3 % of a core, executors
ran more than twice a second."""
LOST_S = 10.0
"""PHM waits this long for a node that left the graph while its process runs: on a machine short of CPU, leases expire, and the ROS child
then needs up to 10 s to rediscover it with a second participant (`phm.probes.ros.graph_comparison`)."""
GOODBYE_S = 0.3
"""Nodes that shut down cleanly leave the graph a moment before PHM sees that their container has exited."""
BARE_S = 2.0
"""A name may stay listed this long after its endpoints."""
DISPROVED_S = 2.0
"""Messages of an ended process may arrive this late on a busy machine."""
NEWER_S = 0.3
"""A sign of life counts as newer than a process list only by at least one topic poll; topics are polled every 0.25 s."""


@dataclass(frozen=True, slots=True)
class NodeHistory:
    """alive: the previous verdict was alive. seen: the node was alive in the current container generation. starting: it, or its
    container, started a moment ago. twice: it has been listed more than once for longer than any lease. contained: it runs in a
    container whose processes PHM requests from the engine. unlisted: the engine could not list them. hung: it was hung according to
    its beacon, and has given no sign of life since, in the same process.
    """

    alive: bool = True
    seen: bool = True
    starting: bool = False
    twice: bool = False
    contained: bool = False
    unlisted: bool = False
    hung: bool = False


@dataclass(frozen=True, slots=True)
class NodeVerdict:
    state: NodeState
    words: str
    """The evidence, the decisive piece first."""
    busy_s: float = 0.0
    """How long the node has been alive but too busy to answer."""
    witnessed: bool = False
    """The node was in the graph or had a process in this container generation, and the engine reports that its process or its container
    has ended or is stopped, or the node reports that its executor has been blocked for CERTAIN_HANG_S: a delay cannot look like that."""
    certain: bool = False
    """The engine reports that its process has ended or is stopped, and its start is over: it does not come back by waiting."""
    age_s: float = 0.0
    """How long ago that was observed, if it is certain."""


@dataclass(frozen=True, slots=True)
class Findings:
    """All evidence about one node, at most one piece of each kind."""

    of: Mapping[Kind, EvidencePiece]
    past: NodeHistory

    def evidence(self, kind: Kind, *what: Observation) -> EvidencePiece | None:
        found = self.of.get(kind)
        return found if found is not None and found.says in what else None

    @property
    def signs(self) -> list[EvidencePiece]:
        """Its beacon and its topics, in this order, as far as they are received."""
        signs = (
            self.evidence(Kind.BEACON, Observation.ALIVE, Observation.LATE),
            self.evidence(Kind.TOPICS, Observation.ALIVE),
        )
        return [sign for sign in signs if sign is not None]

    def alive_since(self, then: EvidencePiece) -> bool:
        """Whether the node sent a beacon or published after `then` was observed."""
        return any(sign.age_s + NEWER_S < then.age_s for sign in self.signs)

    @property
    def sends(self) -> bool:
        """Whether it is listed and what it sends is not late: its beacon, which is the first to be, or its topics if it has none."""
        if self.evidence(Kind.NAME, Observation.ALIVE) is None or self.evidence(Kind.BEACON, Observation.SILENT):
            return False
        return any(not sign.overdue for sign in self.signs[:1])


RuleResult = tuple[NodeState, Kind | None] | None
"""The state and the kind of evidence that decided, or None."""


def judge_node(evidence: Iterable[EvidencePiece], past: NodeHistory) -> NodeVerdict:
    """Determine the state of one node."""
    case = Findings({piece.kind: piece for piece in evidence}, past)
    verdicts = (rule(case) for rule in RULES)
    state, decisive = next((verdict for verdict in verdicts if verdict is not None), (NodeState.UNKNOWN, None))
    busy = case.evidence(Kind.PROCESS, Observation.BUSY)
    unanswered = case.evidence(Kind.BEACON, Observation.SILENT, Observation.LATE)
    busy_s = unanswered.lasted_s if state is NodeState.ALIVE and busy is not None and unanswered is not None else 0.0
    pieces = sorted(case.of.values(), key=lambda piece: (piece.kind is not decisive, piece.kind))
    bad = state in (NodeState.DEAD, NodeState.HUNG)
    witnessed = bad and (decisive in (Kind.CONTAINER, Kind.PROCESS) or _certainly_blocked(case))
    certain = bad and decisive is Kind.PROCESS and not past.starting
    age_s = case.of[Kind.PROCESS].age_s if certain else 0.0
    return NodeVerdict(state, "; ".join(piece.words for piece in pieces), busy_s, witnessed, certain, age_s)


def disproved(evidence: Iterable[EvidencePiece]) -> bool:
    """Whether the node has sent for DISPROVED_S after the process that was taken for its own had ended: it was another program's."""
    case = Findings({piece.kind: piece for piece in evidence}, NodeHistory())
    gone = case.evidence(Kind.PROCESS, Observation.GONE)
    return gone is not None and any(sign.age_s + DISPROVED_S < gone.lasted_s for sign in case.signs)


def container(case: Findings) -> RuleResult:
    """1. Nothing is alive in a container that is not running, and nothing runs in a paused one. A node that is missing from a
    terminating container ends with it: the engine will report that."""
    if case.evidence(Kind.CONTAINER, Observation.ENDING):
        return NodeState.UNKNOWN, Kind.CONTAINER
    if case.evidence(Kind.CONTAINER, Observation.GONE):
        return NodeState.DEAD, Kind.CONTAINER
    return (NodeState.HUNG, Kind.CONTAINER) if case.evidence(Kind.CONTAINER, Observation.STOPPED) else None


def process(case: Findings) -> RuleResult:
    """2. If its process has ended, the node is dead; if its process is stopped, the node is hung, unless it gave a sign of life since,
    or its next one is not late yet: a program that only has the node's name in its command line may have ended.

    A node that has just left the graph may be terminating with its container: PHM waits for that.
    """
    found = case.evidence(Kind.PROCESS, Observation.GONE, Observation.STOPPED)
    if found is None or case.alive_since(found) or case.sends:
        return None
    if found.says is Observation.STOPPED:
        return NodeState.HUNG, Kind.PROCESS
    return (NodeState.ALIVE, Kind.NAME) if _just_left(case) else (_missing(case), Kind.PROCESS)


def _missing(case: Findings) -> NodeState:
    return NodeState.DEAD if case.past.seen else NodeState.NEVER_STARTED


def _just_left(case: Findings) -> bool:
    name = case.evidence(Kind.NAME, Observation.GONE)
    return case.past.alive and name is not None and name.lasted_s < GOODBYE_S


def silent_beacon(case: Findings) -> RuleResult:
    """3. A beacon has its own thread: if it is silent, the process is dead, stopped, or gets no CPU.

    Data on topics, or a process that uses the CPU, proves the last case; a process that sleeps gets more time.
    """
    beacon = case.evidence(Kind.BEACON, Observation.SILENT)
    if beacon is None or case.evidence(Kind.NAME, Observation.GONE):
        return None
    if case.evidence(Kind.TOPICS, Observation.ALIVE):
        return NodeState.ALIVE, Kind.TOPICS
    if case.evidence(Kind.PROCESS, Observation.BUSY):
        return NodeState.ALIVE, Kind.PROCESS
    if case.evidence(Kind.PROCESS, Observation.ALIVE) or case.past.unlisted:
        return _unanswering(case, beacon), Kind.BEACON
    return NodeState.DEAD, Kind.BEACON


def late_beacon(case: Findings) -> RuleResult:
    """4. An executor that does not run is hung, unless the process uses the CPU or publishes from another thread."""
    beacon = case.evidence(Kind.BEACON, Observation.LATE)
    if beacon is None:
        return None
    if case.evidence(Kind.PROCESS, Observation.BUSY):
        return NodeState.ALIVE, Kind.PROCESS
    if case.evidence(Kind.TOPICS, Observation.ALIVE):
        return NodeState.ALIVE, Kind.TOPICS
    return _unanswering(case, beacon), Kind.BEACON


def _certainly_blocked(case: Findings) -> bool:
    """The process sends its beacons in time and uses no CPU, and its executor has neither run nor published for CERTAIN_HANG_S."""
    late, process = case.evidence(Kind.BEACON, Observation.LATE), case.evidence(Kind.PROCESS, Observation.ALIVE)
    silent = case.evidence(Kind.TOPICS, Observation.SILENT)
    if silent is not None and silent.lasted_s < CERTAIN_HANG_S:
        return False  # it has published since then: it is slow, as on a disk that is
    return late is not None and late.lasted_s >= CERTAIN_HANG_S and process is not None and process.measured


def _unanswering(case: Findings, beacon: EvidencePiece) -> NodeState:
    """A process known not to use the CPU is hung. If that is unknown, a node in a container does not count as hung: recovery would
    restart a node that is only busy. Before HANG_S it is reported where two observations agree: it says itself that its executor
    does not run, and its data is missing."""
    process = case.evidence(Kind.PROCESS, Observation.ALIVE)
    topics = case.evidence(Kind.TOPICS, Observation.SILENT)
    if process is not None and process.measured:
        if beacon.lasted_s >= HANG_S:
            return NodeState.HUNG
        silent = topics is not None and topics.overdue and process.lasted_s >= beacon.lasted_s
        return NodeState.BLOCKED if silent and beacon.says is Observation.LATE else NodeState.UNKNOWN
    mute = (
        process is None
        and beacon.says is Observation.SILENT
        and topics is not None
        and min(topics.lasted_s, beacon.lasted_s) >= MUTE_S
    )
    if case.past.contained and (mute or beacon.lasted_s >= BLIND_HANG_S):
        return NodeState.UNANSWERING
    return NodeState.UNKNOWN if beacon.lasted_s < BLIND_HANG_S else NodeState.HUNG


def sign_of_life(case: Findings) -> RuleResult:
    """5. A node that sends beacons or publishes is alive, whatever the graph says."""
    for kind in (Kind.BEACON, Kind.TOPICS):
        if case.evidence(kind, Observation.ALIVE):
            return (NodeState.DUPLICATE, Kind.NAME) if case.past.twice else (NodeState.ALIVE, kind)
    return None


def left_the_graph(case: Findings) -> RuleResult:
    """6. If its name is gone, the node is dead; while its process runs, only after LOST_S, and never while it uses the CPU."""
    name = case.evidence(Kind.NAME, Observation.GONE)
    if name is None:
        return None
    if _just_left(case):
        return NodeState.ALIVE, Kind.NAME
    runs = case.evidence(Kind.PROCESS, Observation.ALIVE) and name.lasted_s < LOST_S
    if case.past.starting or runs or case.evidence(Kind.PROCESS, Observation.BUSY):
        return NodeState.UNKNOWN, Kind.NAME
    return _missing(case), Kind.NAME


def bare_name(case: Findings) -> RuleResult:
    """7. A name without its endpoints is not alive, unless its process is: then its topics are at fault."""
    ends = case.evidence(Kind.ENDPOINTS, Observation.GONE)
    if ends is None or case.evidence(Kind.PROCESS, Observation.ALIVE, Observation.BUSY):
        return None
    sure = ends.lasted_s >= BARE_S and not case.past.starting
    return (NodeState.DEAD if sure else NodeState.UNKNOWN), Kind.ENDPOINTS


def listed(case: Findings) -> RuleResult:
    """8. Otherwise the graph decides. A silent topic alone is not evidence of death: it is a separate fault.

    A hung process may still announce its name: after a replacement of the ROS child, which has never received its beacon, the name
    does not show that the process runs again.
    """
    if case.evidence(Kind.NAME, Observation.ALIVE) is None:
        return None
    if case.past.hung and not case.past.twice and case.evidence(Kind.PROCESS, Observation.BUSY) is None:
        return NodeState.UNKNOWN, Kind.NAME
    return (NodeState.DUPLICATE if case.past.twice else NodeState.ALIVE), Kind.NAME


RULES: tuple[Callable[[Findings], RuleResult], ...] = (
    container,
    process,
    silent_beacon,
    late_beacon,
    sign_of_life,
    left_the_graph,
    bare_name,
    listed,
)
