"""The data types of PHM: levels, slots, results, transitions, faults, reports.

Pure data: no clock, no input or output, no third-party imports, so that every other module can
import this one. All records are frozen; mutable state is kept by its owner (tracker, executor).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum

Value = str | int | float | bool | None
"""Types allowed in a result's `values`: those that JSON represents without loss."""
Values = Mapping[str, Value]
NOT_OBSERVED = frozenset({"configuration", "timeout"})
"""`Fault.by` of a fault that was closed although no one had observed its unit again: how long it lasted is not known."""
NO_ACTION = NOT_OBSERVED | {"", "itself", "reboot"}
"""`Fault.by` of a fault that no action of PHM ended."""
ON_HOLD = "on_hold"
"""Condition of a STALE unit whose target is on hold: the unit is bad intentionally, so this is not a fault."""


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

    @property
    def severity(self) -> int:
        """For the worst of several: OK, STALE, WARN, ERROR.

        STALE is worse than OK, so that an unknown unit is never shown as healthy, but less bad than known problems.
        """
        return _SEVERITY[self]


_SEVERITY = (0, 2, 3, 1)


class Slot(IntEnum):
    """Position in the status array; 1 to 8 are numbered as in Fig. 5 of the PHM paper."""

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

    @property
    def short(self) -> str:
        """Three letters, for the head of a column."""
        return _SHORT_NAMES[self - 1]


_SHORT_NAMES = ["GCS", "CON", "FIL", "NET", "DEV", "NOD", "TOP", "RAT", "HST", "AUT", "RAD", "PEE", "US1", "US2", "US3"]


class Layer(str, Enum):
    """The three layers of the paper, the links between them, and custom checks."""

    COMPANION = "companion"
    DOCKER = "docker"
    ROS = "ros"
    LINK = "link"
    CUSTOM = "custom"


@dataclass(frozen=True, slots=True)
class Stamp:
    """One point in time on both clocks: `utc` in seconds since the epoch, `mono` in seconds of the monotonic clock.

    Calculate intervals from `mono` only, because `utc` can jump.
    """

    utc: float
    mono: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """What tracker and recovery need to know about a result besides its level and condition. The defaults claim nothing.

    generation:   the run of the target container that the check observed (`phm.facts.ContainerFact.generation`).
    certain:      more time would not change this bad result, and no network has caused it: it counts during grace, too, and ends the
                  verification of an action that has not ended it.
    observed:     when a certain result was observed (monotonic seconds), if that was before the run of the check, such as in an
                  earlier list of processes; infinity: in that run.
    conclusive:   the problem itself was observed, not inferred from delay or silence: resource starvation cannot explain it.
    in_time:      the observation that failed was made without delay: a busy CPU of the machine (`cpu_high`) does not explain it.
                  What delays the container itself may, e.g. if the observation asks how old the application's data are.
    never_ok:     whether the subject has never been OK since its container was started; None: the check does not know.
    listed:       how many times the ROS graph still lists the name of the missing node; None: unknown.
    file:         path of the faulty file inside the container.
    broken_hop:   name of the first broken hop on the command path.
    rising:       the newest measurement is above the limit, but not for long enough to report it yet.
    falling:      the newest measurement is below the limit; the report only has not ended yet.
    ended_by:     what ended the earlier failure of the unit, as observed, e.g. ``reboot``: no action is credited for it.
    forecast:     the unit works, and this WARN is about what may come: an earlier failure of the unit is over.
    recovered:    this WARN is about something else, and an earlier failure of the unit is over. Not for a weaker level of the same
                  measurement.
    unobserved:   PHM has not observed the subject since its start, and this OK does not say that an earlier failure is over.
    subjects:     names of those that this bad result is about, or that this OK covers, where the unit reports on several that are not
                  configured: after a restart of PHM an OK must cover all that had failed before. None: this OK covers all.
    unobserved_of: subjects that this OK does not cover, because PHM has not observed them since its start.
    patient:      it may come back by itself: recovery waits for `recovery.patience`, as for a topic.
    """

    generation: str = ""
    certain: bool = False
    observed: float = float("inf")
    conclusive: bool = False
    in_time: bool = False
    never_ok: bool | None = None
    listed: int | None = None
    file: str = ""
    broken_hop: str = ""
    rising: bool = False
    falling: bool = False
    ended_by: str = ""
    forecast: bool = False
    recovered: bool = False
    unobserved: bool = False
    subjects: tuple[str, ...] | None = None
    unobserved_of: tuple[str, ...] = ()
    patient: bool = False


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
class NodeVotes:
    """The consensus about one ROS node: the verdict of the majority, and who votes how, by full node name, `PHM` last.

    verdict: alive, hung, dead or undecided.
    """

    node: str
    verdict: str
    alive: tuple[str, ...] = ()
    dead: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Result:
    """Result of one run of a check for one unit (see `phm.api.Unit`).

    level:     OK, WARN, ERROR, or STALE when the check could not determine the state.
    summary:   one sentence for the log: the subject, what was expected, what was found, and what to do.
    brief:     at most 38 ASCII characters for the operator's line, e.g. ``node_1 dead``; empty when OK.
    condition: one machine-readable word for the problem (``exited``, ``unhealthy``); it selects the
               ladder of recovery actions. Empty when OK.
    target:    name of the container (as in the configuration) that recovery may act on, or empty.
    values:    measurements for logs and reporters, with the unit in the key. PHM does not base decisions on them.
    bypass:    the check had nothing to evaluate: OK, shown as n/a and logged as BYPASS. It does not set the level of its slot.
    settle_s:  how long a bad result must last before it is published; overrides `Unit.settle_s`. Shorter if there is
               evidence that no dependency is the cause, longer for problems that have recovered by themselves before.
    decides_s: for a STALE result that only time can change: it becomes OK or ERROR at most this many seconds after the
               start of its container. The verification of an action waits that long.
    age_s:     age of the evidence if the check could not get newer evidence: Docker runs health checks on its own schedule.
               Infinity: it may be of any age, because PHM has just started.
    evidence:  what tracker and recovery need to know besides level and condition.
    readings:  measurements of the companion computer, from checks that make them.
    votes:     the consensus about each ROS node, from the check that determines it.
    rate_hz:   measured rate of the topic, from the check that measures it; None: not known.
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
    votes: tuple[NodeVotes, ...] = ()
    rate_hz: float | None = None

    @property
    def ends_fault(self) -> bool:
        """Whether the earlier failure is over: OK, or a WARN that states so: what ended it, a forecast, or something else."""
        known = bool(self.evidence.ended_by) or self.evidence.forecast or self.evidence.recovered
        return self.level is Level.OK or (self.level is Level.WARN and known)

    def with_evidence(self, evidence: Evidence) -> Result:
        """Return a copy of this result with `evidence`."""
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

    @property
    def not_applicable(self) -> bool:
        """Whether its check had nothing to evaluate. A problem or STALE is always a statement."""
        return self.level is Level.OK and self.result.bypass


@dataclass(frozen=True, slots=True)
class Transition:
    """A debounced change of the published state of a unit.

    `changed_text` is set when the level is unchanged but its cause or its wording is not (a second
    network is lost while the first is still lost): reporters send it, and recovery evaluates it again.
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
    """How a fault ended. REATTRIBUTED: another open fault turned out to be its cause."""

    OPEN = "open"
    RESOLVED = "resolved"
    ESCALATED = "escalated"
    REATTRIBUTED = "reattributed"


@dataclass(frozen=True, slots=True)
class Fault:
    """One failure of one unit, from its transition to ERROR until it is closed.

    by:               ``itself``, the name of the action that ended it, or what ended it as its check observed
                      (`Evidence.ended_by`).
    blocks:           units that are STALE because of it, in the order in which they were found.
    consequences:     names of the checks that cannot be OK while it lasts, from the dependency graph. Known as soon as the
                      fault opens.
    suspects:         units that were in ERROR when it opened and can cause any fault, such as a full disk: a hint, not a
                      diagnosis.
    ok_s:             the longest time for which the unit was published as OK without interruption, in seconds: either until
                      it failed, or earlier, since its last fault opened and its container was started.
    ok_since_start_s: total seconds for which the unit was published as OK since PHM last saw its target container start;
                      interruptions do not reset it.
    ok_in_run_before_s: the same in the run of the container before that, if PHM ended it; 0: something else did.
    start_seen:       whether PHM saw that start at all. If not, the container has been running for longer than PHM.
    pause_s:          the longest earlier ERROR of this unit that ended by itself, without a start of its container, in
                      seconds; 0: none did since PHM started.
    generation:       the run of the target container in which the fault opened, as a check saw it last
                      (`phm.facts.ContainerFact.generation`). Empty if none is known or PHM was restarted since.
    node:             the ROS node that the unit declares (`phm.api.Unit.node`), or empty.
    confirmed_s:      from the start of the first run that found the error until the fault opened; None: not known.
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
    ok_in_run_before_s: float = 0.0
    start_seen: bool = False
    pause_s: float = 0.0
    generation: str = ""
    node: str = ""
    confirmed_s: float | None = None


@dataclass(frozen=True, slots=True)
class FaultOpened:
    at: Stamp
    fault: Fault


@dataclass(frozen=True, slots=True)
class FaultClosed:
    """Published once per fault; `fault.outcome` and `fault.by` show how it ended."""

    at: Stamp
    fault: Fault


class Phase(str, Enum):
    """Progress of an action. In the phases ADVISED, EXPIRED and REFUSED nothing is done to the target.

    EXPIRED: the approval is no longer valid.
    """

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
    """One step of a recovery. `detail` is a sentence for the log; after a failure it includes the next step."""

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
    """A line for the log. `kind`: ACTION, COMMAND, DOCKER, HOLD, NOTE (written by an operator) or PHM."""

    at: Stamp
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class ReportStarted:
    at: Stamp
    number: int


@dataclass(frozen=True, slots=True)
class Report:
    """Result of one pass over all checks. `units` is in configuration order.

    missing: units whose check did not finish in this pass; their state in `units` is older.
    """

    at: Stamp
    number: int
    started: Stamp
    units: tuple[UnitState, ...]
    missing: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class HoldChanged:
    """A hold began, or ended (`began` is false). If another one still applies at the end, the event is of that one.

    target: key of the container; empty: all containers. by, reason: who set the hold, and why. left_s: how long it will last,
    or, when it ended, how long it would still have lasted. text: a sentence for the log.
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
    """Return the worst level of each used slot, in the order ERROR, WARN, STALE, OK.

    A slot in which all units are not applicable is not used: nothing in it was evaluated.
    """
    slots: dict[Slot, Level] = {}
    for state in units:
        if state.not_applicable:
            continue
        seen = slots.get(state.slot)
        if seen is None or state.level.severity > seen.severity:
            slots[state.slot] = state.level
    return slots
