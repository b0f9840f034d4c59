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


class Says(Enum):
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


class State(Enum):
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
    says: Says
    words: str
    age_s: float = 0.0
    lasted_s: float = 0.0
    measured: bool = True


@dataclass(frozen=True, slots=True)
class Past:
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
class Judgement:
    state: State
    words: str
    """The evidence, the decisive first."""
    busy_s: float = 0.0
    """Alive, but so busy that it has not answered for this long."""
    witnessed: bool = False
    """It was in the graph or had a process in this life, and the engine says that its process has ended or is stopped, or its
    container: no lateness looks like that."""


@dataclass(frozen=True, slots=True)
class Case:
    """All evidence about one node, at most one piece of each kind."""

    of: Mapping[Kind, Evidence]
    past: Past

    def says(self, kind: Kind, *what: Says) -> Evidence | None:
        found = self.of.get(kind)
        return found if found is not None and found.says in what else None

    def alive_since(self, then: Evidence) -> bool:
        """Whether the node beat or published after `then` was observed."""
        signs = (self.says(Kind.BEACON, Says.ALIVE, Says.LATE), self.says(Kind.TOPICS, Says.ALIVE))
        return any(sign is not None and sign.age_s + NEWER_S < then.age_s for sign in signs)


Verdict = tuple[State, Kind | None] | None
"""The state and the kind of evidence that decided, or nothing."""


def fuse(evidence: Iterable[Evidence], past: Past) -> Judgement:
    """The state of one node."""
    case = Case({piece.kind: piece for piece in evidence}, past)
    verdicts = (rule(case) for rule in RULES)
    state, decisive = next((verdict for verdict in verdicts if verdict is not None), (State.UNKNOWN, None))
    busy = case.says(Kind.PROCESS, Says.BUSY)
    unanswered = case.says(Kind.BEACON, Says.SILENT, Says.LATE)
    busy_s = unanswered.lasted_s if state is State.ALIVE and busy is not None and unanswered is not None else 0.0
    pieces = sorted(case.of.values(), key=lambda piece: (piece.kind is not decisive, piece.kind))
    witnessed = state in (State.DEAD, State.HUNG) and decisive in (Kind.CONTAINER, Kind.PROCESS)
    return Judgement(state, "; ".join(piece.words for piece in pieces), busy_s, witnessed)


def container(case: Case) -> Verdict:
    """1. Nothing lives in a container that does not run, and nothing moves in one that is paused. What is missing in one that ends
    goes with it: the engine will say so."""
    if case.says(Kind.CONTAINER, Says.ENDING):
        return State.UNKNOWN, Kind.CONTAINER
    if case.says(Kind.CONTAINER, Says.GONE):
        return State.DEAD, Kind.CONTAINER
    return (State.HUNG, Kind.CONTAINER) if case.says(Kind.CONTAINER, Says.STOPPED) else None


def process(case: Case) -> Verdict:
    """2. A process that ended is a dead node, one that is stopped a hung node, unless it gave a sign of life since.

    A node that said good-bye may go with its container: that is waited for.
    """
    found = case.says(Kind.PROCESS, Says.GONE, Says.STOPPED)
    if found is None or case.alive_since(found):
        return None
    if found.says is Says.STOPPED:
        return State.HUNG, Kind.PROCESS
    return (State.ALIVE, Kind.NAME) if _just_left(case) else (_missing(case), Kind.PROCESS)


def _missing(case: Case) -> State:
    return State.DEAD if case.past.seen else State.NEVER_STARTED


def _just_left(case: Case) -> bool:
    name = case.says(Kind.NAME, Says.GONE)
    return case.past.alive and name is not None and name.lasted_s < GOODBYE_S


def silent_beacon(case: Case) -> Verdict:
    """3. A beacon has a thread of its own: when it is silent the process is dead, stopped, or has no processor.

    Topics that flow, or a process that computes, prove the last; one that sleeps is given time.
    """
    beacon = case.says(Kind.BEACON, Says.SILENT)
    if beacon is None or case.says(Kind.NAME, Says.GONE):
        return None
    if case.says(Kind.TOPICS, Says.ALIVE):
        return State.ALIVE, Kind.TOPICS
    if case.says(Kind.PROCESS, Says.BUSY):
        return State.ALIVE, Kind.PROCESS
    if case.says(Kind.PROCESS, Says.ALIVE) or case.past.unlisted:
        return _unanswering(case, beacon), Kind.BEACON
    return State.DEAD, Kind.BEACON


def late_beacon(case: Case) -> Verdict:
    """4. An executor that does not turn hangs, unless the process computes, or publishes from another thread."""
    beacon = case.says(Kind.BEACON, Says.LATE)
    if beacon is None:
        return None
    if case.says(Kind.PROCESS, Says.BUSY):
        return State.ALIVE, Kind.PROCESS
    if case.says(Kind.TOPICS, Says.ALIVE):
        return State.ALIVE, Kind.TOPICS
    return _unanswering(case, beacon), Kind.BEACON


def _unanswering(case: Case, beacon: Evidence) -> State:
    """A process that is known not to compute hangs. Where nobody can tell, a node of a container is not taken for hung: a busy
    one would be restarted for it."""
    process = case.says(Kind.PROCESS, Says.ALIVE)
    if process is not None and process.measured:
        return State.HUNG if beacon.lasted_s >= HANG_S else State.UNKNOWN
    if beacon.lasted_s < BLIND_HANG_S:
        return State.UNKNOWN
    return State.UNANSWERING if case.past.contained else State.HUNG


def sign_of_life(case: Case) -> Verdict:
    """5. Whoever beats or publishes is alive, whatever the graph says."""
    for kind in (Kind.BEACON, Kind.TOPICS):
        if case.says(kind, Says.ALIVE):
            return (State.DUPLICATE, Kind.NAME) if case.past.twice else (State.ALIVE, kind)
    return None


def left_the_graph(case: Case) -> Verdict:
    """6. A name that is gone is a dead node; while its process runs, only after LOST_S, and never while it computes."""
    name = case.says(Kind.NAME, Says.GONE)
    if name is None:
        return None
    if _just_left(case):
        return State.ALIVE, Kind.NAME
    runs = case.says(Kind.PROCESS, Says.ALIVE) and name.lasted_s < LOST_S
    if case.past.starting or runs or case.says(Kind.PROCESS, Says.BUSY):
        return State.UNKNOWN, Kind.NAME
    return _missing(case), Kind.NAME


def bare_name(case: Case) -> Verdict:
    """7. A name without its endpoints is not alive, unless its process is: then it is its topics that are at fault."""
    ends = case.says(Kind.ENDPOINTS, Says.GONE)
    if ends is None or case.says(Kind.PROCESS, Says.ALIVE, Says.BUSY):
        return None
    sure = ends.lasted_s >= BARE_S and not case.past.starting
    return (State.DEAD if sure else State.UNKNOWN), Kind.ENDPOINTS


def listed(case: Case) -> Verdict:
    """8. Else it is as the graph says. A topic that is silent is not by itself a sign of death: that is its own fault."""
    if case.says(Kind.NAME, Says.ALIVE) is None:
        return None
    return (State.DUPLICATE if case.past.twice else State.ALIVE), Kind.NAME


RULES: tuple[Callable[[Case], Verdict], ...] = (
    container,
    process,
    silent_beacon,
    late_beacon,
    sign_of_life,
    left_the_graph,
    bare_name,
    listed,
)
