"""Pieces of evidence about a node: where each comes from, and what it says."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum


class Kind(IntEnum):
    """The source of a piece of evidence, the most reliable first."""

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
    """The node's process uses the CPU."""
    LATE = "late"
    """It sends beacons, but its executor does not run."""
    STOPPED = "stopped"
    """Frozen from outside: it does nothing until it is resumed."""
    SILENT = "silent"
    GONE = "gone"
    ENDING = "ending"
    """Of a container: it is terminating with everything in it, and the engine has not noticed yet."""


@dataclass(frozen=True, slots=True)
class EvidencePiece:
    """age_s: time since it was observed. lasted_s: how long the state has lasted. words: a clause for the operator. measured: for a
    process, whether its CPU use is known; its `lasted_s` is how long it has used none. overdue: for a beacon or topic that is
    alive, whether the next message is late; for silent topics, whether each is silent for longer than its limit."""

    kind: Kind
    says: Observation
    words: str
    age_s: float = 0.0
    lasted_s: float = 0.0
    measured: bool = True
    overdue: bool = False
