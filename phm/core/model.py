"""The data types of PHM: levels, slots, results, transitions, faults, reports.

Pure data: no clock, no input or output, no third-party import, so that every other module may
import this one. All records are frozen; what changes is kept by its owner (tracker, executor).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum

Value = str | int | float | bool | None
"""What a result's `values` may hold: exactly what JSON can carry without loss."""
ON_HOLD = "on_hold"
"""The condition of a STALE unit whose target is on hold: it is bad, on purpose, and no fault."""


class Level(IntEnum):
    """State of a unit; numbers and names of `diagnostic_msgs/DiagnosticStatus`.

    STALE means *unknown*: not run yet, overdue, not determinable, or blocked by another fault.
    """

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @property
    def bad(self) -> bool:
        """WARN or ERROR: a problem is known."""
        return self in (Level.WARN, Level.ERROR)


class Slot(IntEnum):
    """Place in the status array; 1 to 8 are numbered as in Fig. 5 of the PHM paper."""

    COMPANION = 1
    CONTAINER = 2
    FILES = 3
    NETWORK = 4
    DEVICES = 5
    NODES = 6
    TOPICS = 7
    RATES = 8
    HOST = 9
    AUTOPILOT = 10
    RADIO = 11
    PEERS = 12
    USER_1 = 13
    USER_2 = 14
    USER_3 = 15


class Layer(str, Enum):
    """The three layers of the paper, the links between them, and custom checks."""

    COMPANION = "companion"
    DOCKER = "docker"
    ROS = "ros"
    LINK = "link"
    CUSTOM = "custom"


@dataclass(frozen=True, slots=True)
class Stamp:
    """One moment on both clocks: `utc` seconds since the epoch, `mono` seconds of the monotonic clock.

    Intervals are differences of `mono` only; `utc` may jump.
    """

    utc: float
    mono: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """What tracker and recovery need to know about a result besides its level and condition. The defaults claim nothing.

    generation:   which run of the target container the check saw (`phm.facts.ContainerFact.generation`).
    certain:      more time would not change this bad result, so it counts during grace, too.
    conclusive:   the problem itself was observed, not inferred from delay or silence: resource starvation cannot explain it.
    never_ok:     whether the subject has never been OK since its container was started; None: the check does not know.
    listed:       how many times the name of the missing node is still in the ROS graph; None: unknown.
    file:         path, in the container, of the file that is wrong.
    broken_hop:   name of the first broken hop on the command path.
    """

    generation: str = ""
    certain: bool = False
    conclusive: bool = False
    never_ok: bool | None = None
    listed: int | None = None
    file: str = ""
    broken_hop: str = ""


@dataclass(frozen=True, slots=True)
class HostReadings:
    """Measurements of the companion computer for ONBOARD_COMPUTER_STATUS; None or empty: not measured by this check.

    disks: total and free bytes of each watched disk, in the order of the configuration.
    """

    cpu_percent: float | None = None
    memory_percent: float | None = None
    temperature_c: float | None = None
    fans_rpm: tuple[int, ...] = ()
    disks: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one run of a check for one unit (see `phm.api.Unit`).

    level:     OK, WARN, ERROR, or STALE when the check could not tell.
    summary:   one sentence for the log: what, expected, seen, and what to do.
    brief:     at most 38 ASCII characters for the operator's line, e.g. ``node_1 dead``; empty when OK.
    condition: one machine word that names what is wrong (``exited``, ``unhealthy``); it selects the
               ladder of recovery actions. Empty when OK.
    target:    name of the container (as in the configuration) that a recovery may act on, or empty.
    values:    measured numbers for logs and reporters, units in the key names. PHM makes no decision from them.
    bypass:    the check had nothing to judge and counts as OK (logged as BYPASS).
    settle_s:  how long a bad result must last before it is told, where the check knows better than `Unit.settle_s`:
               shorter with evidence that nothing above it is the cause, longer for what was seen to mend itself.
    decides_s: a STALE result that only time can change: from the start of its container it takes at most so many seconds
               until it is OK or ERROR. The verification of an action waits for that.
    age_s:     how old the evidence is where no newer could be had: the engine's health check probes in its own time.
    evidence:  what tracker and recovery need to know besides level and condition.
    readings:  measurements of the companion computer, from checks that make them.
    """

    level: Level
    summary: str
    brief: str = ""
    condition: str = ""
    target: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    bypass: bool = False
    settle_s: float | None = None
    decides_s: float | None = None
    age_s: float = 0.0
    evidence: Evidence = Evidence()
    readings: HostReadings | None = None

    def with_evidence(self, evidence: Evidence) -> Result:
        """The same result with this evidence."""
        return replace(self, evidence=evidence)


@dataclass(frozen=True, slots=True)
class UnitState:
    """The published state of one unit."""

    unit: str
    check: str
    slot: Slot
    layer: Layer
    level: Level
    result: Result
    since: Stamp
    blocked_by: str = ""
    fault: str = ""
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Transition:
    """A debounced change of the published state of a unit.

    `changed_text` is set when the level stayed but its cause or its wording did (a second network
    lost while the first still is): reporters send it, recovery evaluates it again.
    """

    at: Stamp
    old: Level
    state: UnitState
    changed_text: bool = False

    @property
    def unit(self) -> str:
        return self.state.unit

    @property
    def new(self) -> Level:
        return self.state.level


class Outcome(str, Enum):
    """How a fault ended. REATTRIBUTED: it turned out to follow from another open fault."""

    OPEN = "open"
    RESOLVED = "resolved"
    ESCALATED = "escalated"
    REATTRIBUTED = "reattributed"


@dataclass(frozen=True, slots=True)
class Fault:
    """An episode at one unit, from the transition to ERROR until it is over.

    `by` is ``itself`` or the name of the action that ended it; `blocks` lists the units that are
    STALE because of it, in the order in which they were found; `consequences` names the checks that
    cannot be well while it lasts, by the graph of needs (known at once, when the alarm is raised);
    `suspects` names units that were ERROR then and can be behind anything, a full disk: a hint, not a verdict;
    `well_s` is for how many seconds the unit had been told as OK, without a break, when it broke;
    `well_in_life_s` the same in all since its target's container was last seen to be started, breaks or not; `life_seen`
    whether that start was seen at all: else the container runs for longer than PHM; `life` names the life of that container in
    which the fault opened, as a check saw it last (`phm.facts.ContainerFact.generation`), empty where none is known or PHM has been
    restarted since.
    """

    id: str
    unit: str
    slot: Slot
    layer: Layer
    result: Result
    opened: Stamp
    closed: Stamp | None = None
    outcome: Outcome = Outcome.OPEN
    by: str = ""
    blocks: tuple[str, ...] = ()
    consequences: tuple[str, ...] = ()
    suspects: tuple[str, ...] = ()
    ok_s: float = 0.0
    ok_since_start_s: float = 0.0
    start_seen: bool = False
    generation: str = ""


@dataclass(frozen=True, slots=True)
class FaultOpened:
    at: Stamp
    fault: Fault


@dataclass(frozen=True, slots=True)
class FaultClosed:
    """Published once per fault; `fault.outcome` and `fault.by` tell how it ended."""

    at: Stamp
    fault: Fault


class Phase(str, Enum):
    """Progress of an action. ADVISED, EXPIRED and REFUSED have no effect. EXPIRED: an approval is no longer valid."""

    ADVISED = "advised"
    APPROVED = "approved"
    EXPIRED = "expired"
    REFUSED = "refused"
    STARTED = "started"
    DONE = "done"
    FAILED = "failed"
    VERIFIED = "verified"
    ESCALATED = "escalated"


@dataclass(frozen=True, slots=True)
class ActionEvent:
    """One step of a recovery. `detail` is a sentence for the log, with the next step when it failed."""

    at: Stamp
    fault: str
    unit: str
    action: str
    target: str
    phase: Phase
    detail: str = ""
    attempt: int = 1


@dataclass(frozen=True, slots=True)
class Note:
    """A line for the log: kind ACTION, COMMAND, DOCKER, HOLD, NOTE (an operator's) or PHM."""

    at: Stamp
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class ReportStarted:
    at: Stamp
    number: int


@dataclass(frozen=True, slots=True)
class Report:
    """One pass over all checks. `units` is in configuration order.

    missing: units whose check did not come back in this pass; what `units` says of them is older.
    """

    at: Stamp
    number: int
    started: Stamp
    units: tuple[UnitState, ...]
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class HoldChanged:
    """A hold has begun, or ended (`began` false).

    target: key of the container; empty: all. by, reason: whose it is and why. left_s: how long it is to last, or would have.
    text: a sentence for the log.
    """

    at: Stamp
    target: str
    began: bool
    by: str
    reason: str
    left_s: float
    text: str


Event = Transition | FaultOpened | FaultClosed | ActionEvent | HoldChanged | Note | ReportStarted | Report


def worst_by_slot(units: tuple[UnitState, ...]) -> dict[Slot, Level]:
    """The level of each used slot: ERROR, then WARN, then STALE, then OK wins.

    STALE beats OK, so that a slot with an unknown part never claims to be well, but loses to what is
    known to be wrong.
    """
    rank = {Level.OK: 0, Level.STALE: 1, Level.WARN: 2, Level.ERROR: 3}
    slots: dict[Slot, Level] = {}
    for state in units:
        seen = slots.get(state.slot)
        if seen is None or rank[state.level] > rank[seen]:
            slots[state.slot] = state.level
    return slots
