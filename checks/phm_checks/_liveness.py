"""Whether a node lives, by all that is known about it: the fusion of evidence. Pure; asks and remembers nothing.

Evidence comes in six kinds, the best first. The first rule that has a verdict decides, so a strong sign is told
at once, and a weak sign of death never against a newer sign of life.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum


class Kind(IntEnum):
    """Where a piece of evidence comes from, the best first."""

    CONTAINER = 1
    PROCESS = 2
    BEACON = 3
    TOPICS = 4
    ENDPOINTS = 5
    NAME = 6


class Observation(Enum):
    """What a piece of evidence says about the node."""

    ALIVE = "alive"
    BUSY = "busy"
    """It computes."""
    LATE = "late"
    """It beats, but its executor does not turn."""
    STOPPED = "stopped"
    """Frozen from outside: it will do nothing until it is let go."""
    SILENT = "silent"
    GONE = "gone"
    ENDING = "ending"
    """Of a container: it goes, and all in it, and the engine has not noticed yet."""


class NodeState(Enum):
    ALIVE = "alive"
    HUNG = "hung"
    UNANSWERING = "unanswering"
    """It hangs or computes: its process could say which, and is not known well enough."""
    DEAD = "dead"
    NEVER_STARTED = "never started"
    DUPLICATE = "duplicate"
    UNKNOWN = "unknown"


HANG_S = 5.0
"""An executor that has not turned for this long hangs, if its process does not compute. Shorter could be a slow callback."""
BLIND_HANG_S = 15.0
"""The same where nobody can tell whether the process computes."""
LOST_S = 5.0
"""A node that left the graph while its process runs is given this long: a starved machine drops leases."""
GOODBYE_S = 0.3
"""Nodes that end in an orderly way leave the graph a moment before their container is seen to have exited."""
BARE_S = 2.0
"""A name may stay listed this long after its endpoints."""
NEWER_S = 0.3
"""A sign of life is newer than a list of processes by at least one look at the topics, which are made every 0.25 s."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """age_s: since it was observed. lasted_s: for how long it has been so. words: a clause for the operator. measured: of a
    process, whether it is known if it computes."""

    kind: Kind
    says: Observation
    words: str
    age_s: float = 0.0
    lasted_s: float = 0.0
    measured: bool = True


@dataclass(frozen=True, slots=True)
class NodeHistory:
    """alive: the node was judged alive just before. seen: it was alive in this life of its container. starting: it, or its
    container, began a moment ago. twice: it has been listed more than once for longer than any lease. contained: it runs in a
    container whose processes the engine is asked for. unlisted: the engine could not list them.
    """

    alive: bool = True
    seen: bool = True
    starting: bool = False
    twice: bool = False
    contained: bool = False
    unlisted: bool = False


@dataclass(frozen=True, slots=True)
class NodeVerdict:
    state: NodeState
    words: str
    """The evidence, the decisive first."""
    busy_s: float = 0.0
    """Alive, but so busy that it has not answered for this long."""
    witnessed: bool = False
    """It was in the graph or had a process in this life, and the engine says that its process has ended or is stopped, or its
    container: no lateness looks like that."""


@dataclass(frozen=True, slots=True)
class Findings:
    """All evidence about one node, at most one piece of each kind."""

    of: Mapping[Kind, Evidence]
    past: NodeHistory

    def says(self, kind: Kind, *what: Observation) -> Evidence | None:
        found = self.of.get(kind)
        return found if found is not None and found.says in what else None

    def alive_since(self, then: Evidence) -> bool:
        """Whether the node beat or published after `then` was observed."""
        signs = (self.says(Kind.BEACON, Observation.ALIVE, Observation.LATE), self.says(Kind.TOPICS, Observation.ALIVE))
        return any(sign is not None and sign.age_s + NEWER_S < then.age_s for sign in signs)


RuleResult = tuple[NodeState, Kind | None] | None
"""The state and the kind of evidence that decided, or nothing."""


def fuse(evidence: Iterable[Evidence], past: NodeHistory) -> NodeVerdict:
    """The state of one node."""
    case = Findings({piece.kind: piece for piece in evidence}, past)
    verdicts = (rule(case) for rule in RULES)
    state, decisive = next((verdict for verdict in verdicts if verdict is not None), (NodeState.UNKNOWN, None))
    busy = case.says(Kind.PROCESS, Observation.BUSY)
    unanswered = case.says(Kind.BEACON, Observation.SILENT, Observation.LATE)
    busy_s = unanswered.lasted_s if state is NodeState.ALIVE and busy is not None and unanswered is not None else 0.0
    pieces = sorted(case.of.values(), key=lambda piece: (piece.kind is not decisive, piece.kind))
    witnessed = state in (NodeState.DEAD, NodeState.HUNG) and decisive in (Kind.CONTAINER, Kind.PROCESS)
    return NodeVerdict(state, "; ".join(piece.words for piece in pieces), busy_s, witnessed)


def container(case: Findings) -> RuleResult:
    """1. Nothing lives in a container that does not run, and nothing moves in one that is paused. What is missing in one that ends
    goes with it: the engine will say so."""
    if case.says(Kind.CONTAINER, Observation.ENDING):
        return NodeState.UNKNOWN, Kind.CONTAINER
    if case.says(Kind.CONTAINER, Observation.GONE):
        return NodeState.DEAD, Kind.CONTAINER
    return (NodeState.HUNG, Kind.CONTAINER) if case.says(Kind.CONTAINER, Observation.STOPPED) else None


def process(case: Findings) -> RuleResult:
    """2. A process that ended is a dead node, one that is stopped a hung node, unless it gave a sign of life since.

    A node that said good-bye may go with its container: that is waited for.
    """
    found = case.says(Kind.PROCESS, Observation.GONE, Observation.STOPPED)
    if found is None or case.alive_since(found):
        return None
    if found.says is Observation.STOPPED:
        return NodeState.HUNG, Kind.PROCESS
    return (NodeState.ALIVE, Kind.NAME) if _just_left(case) else (_missing(case), Kind.PROCESS)


def _missing(case: Findings) -> NodeState:
    return NodeState.DEAD if case.past.seen else NodeState.NEVER_STARTED


def _just_left(case: Findings) -> bool:
    name = case.says(Kind.NAME, Observation.GONE)
    return case.past.alive and name is not None and name.lasted_s < GOODBYE_S


def silent_beacon(case: Findings) -> RuleResult:
    """3. A beacon has a thread of its own: when it is silent the process is dead, stopped, or has no processor.

    Topics that flow, or a process that computes, prove the last; one that sleeps is given time.
    """
    beacon = case.says(Kind.BEACON, Observation.SILENT)
    if beacon is None or case.says(Kind.NAME, Observation.GONE):
        return None
    if case.says(Kind.TOPICS, Observation.ALIVE):
        return NodeState.ALIVE, Kind.TOPICS
    if case.says(Kind.PROCESS, Observation.BUSY):
        return NodeState.ALIVE, Kind.PROCESS
    if case.says(Kind.PROCESS, Observation.ALIVE) or case.past.unlisted:
        return _unanswering(case, beacon), Kind.BEACON
    return NodeState.DEAD, Kind.BEACON


def late_beacon(case: Findings) -> RuleResult:
    """4. An executor that does not turn hangs, unless the process computes, or publishes from another thread."""
    beacon = case.says(Kind.BEACON, Observation.LATE)
    if beacon is None:
        return None
    if case.says(Kind.PROCESS, Observation.BUSY):
        return NodeState.ALIVE, Kind.PROCESS
    if case.says(Kind.TOPICS, Observation.ALIVE):
        return NodeState.ALIVE, Kind.TOPICS
    return _unanswering(case, beacon), Kind.BEACON


def _unanswering(case: Findings, beacon: Evidence) -> NodeState:
    """A process that is known not to compute hangs. Where nobody can tell, a node of a container is not taken for hung: a busy
    one would be restarted for it."""
    process = case.says(Kind.PROCESS, Observation.ALIVE)
    if process is not None and process.measured:
        return NodeState.HUNG if beacon.lasted_s >= HANG_S else NodeState.UNKNOWN
    if beacon.lasted_s < BLIND_HANG_S:
        return NodeState.UNKNOWN
    return NodeState.UNANSWERING if case.past.contained else NodeState.HUNG


def sign_of_life(case: Findings) -> RuleResult:
    """5. Whoever beats or publishes is alive, whatever the graph says."""
    for kind in (Kind.BEACON, Kind.TOPICS):
        if case.says(kind, Observation.ALIVE):
            return (NodeState.DUPLICATE, Kind.NAME) if case.past.twice else (NodeState.ALIVE, kind)
    return None


def left_the_graph(case: Findings) -> RuleResult:
    """6. A name that is gone is a dead node; while its process runs, only after LOST_S, and never while it computes."""
    name = case.says(Kind.NAME, Observation.GONE)
    if name is None:
        return None
    if _just_left(case):
        return NodeState.ALIVE, Kind.NAME
    runs = case.says(Kind.PROCESS, Observation.ALIVE) and name.lasted_s < LOST_S
    if case.past.starting or runs or case.says(Kind.PROCESS, Observation.BUSY):
        return NodeState.UNKNOWN, Kind.NAME
    return _missing(case), Kind.NAME


def bare_name(case: Findings) -> RuleResult:
    """7. A name without its endpoints is not alive, unless its process is: then it is its topics that are at fault."""
    ends = case.says(Kind.ENDPOINTS, Observation.GONE)
    if ends is None or case.says(Kind.PROCESS, Observation.ALIVE, Observation.BUSY):
        return None
    sure = ends.lasted_s >= BARE_S and not case.past.starting
    return (NodeState.DEAD if sure else NodeState.UNKNOWN), Kind.ENDPOINTS


def listed(case: Findings) -> RuleResult:
    """8. Else it is as the graph says. A topic that is silent is not by itself a sign of death: that is its own fault."""
    if case.says(Kind.NAME, Observation.ALIVE) is None:
        return None
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
