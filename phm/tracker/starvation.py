"""Resource starvation as a cause: which symptoms a shortage of CPU, memory or I/O explains, and which unit reports it. Pure.

A container or machine that waits for resources is late in everything. Conclusions from delay or silence then follow from the
starvation and not from a defect. Direct observations (a process is gone, a network is detached) do not, and count as usual.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from phm.core.model import Level, Result
from phm.tracker.units import Starvation, TrackerView, UnitRecord

WAITING = frozenset({"cpu_throttled", "cpu_starved", "cpu_high", "memory_pressure", "io_pressure"})
"""Conditions of pressure units that mean that tasks are stalled. `memory_high` alone does not: memory is used up, but nothing waits."""
OF_HOST = frozenset({"cpu_high", "memory_pressure", "io_pressure"})
UNKNOWN_PRESSURE_S = 10.0
"""A pressure unit that becomes STALE keeps its last state for this long: an overloaded Docker Engine returns no statistics."""
BEFORE_PRESSURE_S = 5.0
"""A symptom may be published this long before the statistics show its starvation. Older faults stay open."""
WARN_WAIT_S = 3.0
"""While a pressure unit is WARN or rises, symptoms that it may soon explain wait this long, and for a run that began later. WARN
itself explains nothing."""
RECOVERY_S = 5.0
"""After starvation symptoms have this long to disappear."""
FOUND_AGAIN_S = 12.0
"""After starvation a node that left the graph meanwhile has this long to be found again: PHM needs up to 10 s, as without starvation
(`phm_checks._liveness.LOST_S`), and that time counts from when the node left."""


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why starvation can cause a symptom.

    evidence: the reason. by: conditions of pressure units that explain it. settle_s: minimum duration of the symptom if its cause
    shows later. most_s: a symptom that lasts longer is not explained; None: no limit. begins_again: something must be discovered or
    started again before the symptom can disappear, which takes up to the `grace_s` of its unit, and `least_s` if that is longer.
    """

    evidence: str
    by: frozenset[str] = WAITING
    settle_s: float = 0.0
    most_s: float | None = None
    begins_again: bool = False
    least_s: float = RECOVERY_S

    def recovery_s(self, grace_s: float) -> float:
        """How long the symptom may last after the starvation. `grace_s`: of its unit."""
        return max(self.least_s, grace_s) if self.begins_again else self.least_s


UNREAD_S = 15.0
"""PHM excludes its own delay from a silence, so at most about this much can be due to a delayed router on this machine. A link,
autopilot or peer that is silent for longer is lost, however busy the machine is."""
_SLOW = Explanation("its publisher is not scheduled at each period")
_LEASE = Explanation(
    "participants that do not announce themselves in time are dropped from the graph, with all their endpoints",
    begins_again=True,
)
_LATE = Explanation("its beacon or its executor is not scheduled, so its beacon is late")
_UNREAD = Explanation("PHM, or a router on this machine, passes frames on late", most_s=UNREAD_S)
_VIEWS = Explanation("the neighbours' beacons are late, or read late")

EXPLAINED: Mapping[str, Explanation] = {
    "rate_low": _SLOW,
    "jitter_rising": _SLOW,
    "topic_silent": Explanation(f"{_SLOW.evidence}; not where its executor ran twice 2 s after a message was due"),
    "data_stamp": Explanation("messages wait before they are published; not where stamps differ by more than 10 s"),
    "data_gaps": Explanation("its publisher does not read its input in time"),
    "not_received": Explanation("a publisher that is starved from its start has not sent yet", begins_again=True),
    "transport_blocked": Explanation(
        "publishers that are starved from their start are found, and have not sent yet", begins_again=True
    ),
    "topic_missing": _LEASE,
    "publisher_missing": _LEASE,
    "subscriber_missing": _LEASE,
    "publisher_lost": _LEASE,
    "subscriber_lost": _LEASE,
    "node_missing": Explanation(
        f"by the graph or the beacon alone: {_LEASE.evidence}; not where its process is gone",
        begins_again=True,
        least_s=FOUND_AGAIN_S,
    ),
    "node_unreachable": _LEASE,
    "node_hung": Explanation(
        f"{_LATE.evidence}; not where its process or container is stopped, or its executor was blocked for 15 s while "
        "its beacon was in time"
    ),
    "node_blocked": _LATE,
    "node_unanswering": _LATE,
    "node_busy": _LATE,
    "beacon_missing": _LATE,
    "not_ready": Explanation(
        "it answers late, or is dropped from the graph; not where its lifecycle state was observed", begins_again=True
    ),
    "partly_received": _VIEWS,
    "nodes_split": _VIEWS,
    "quorum_dead": _VIEWS,
    "publisher_not_received": _VIEWS,
    "diagnostic_stale": Explanation("its publisher is not scheduled in time", begins_again=True),
    "unhealthy": Explanation(
        "the probe of the health check takes longer than its time-out, or cannot be started; by a busy CPU of the machine, "
        "not where it reported the failure itself within 1 s, twice",
        WAITING | {"pids_limit"},
    ),
    "healthcheck_hangs": Explanation(
        "a run of the health check takes longer, or is started late", WAITING | {"pids_limit"}
    ),
    "autopilot_silent": replace(
        _UNREAD, evidence=f"{_UNREAD.evidence}; not where its link carries frames of others meanwhile"
    ),
    "gcs_lost": replace(
        _UNREAD, evidence=f"{_UNREAD.evidence}; not where the onboard radio reports that it receives nothing"
    ),
    "radio_silent": _UNREAD,
    "link_silent": _UNREAD,
    "frames_lost": Explanation("frames that PHM does not read in time are dropped by the kernel"),
    "peer_lost": Explanation(
        "this agent reads the peer's heartbeats late; not where another agent has lost it, too", most_s=UNREAD_S
    ),
    "peer_partly": _UNREAD,
    "all_peers_lost": _UNREAD,
    "swarm_split": _UNREAD,
    "cpu_starved": Explanation(
        "all containers wait when the machine has no core to spare", OF_HOST, settle_s=WARN_WAIT_S
    ),
    "memory_pressure": Explanation("the machine reclaims memory from all containers", frozenset({"memory_pressure"})),
    "io_pressure": Explanation("all containers wait for the same disk", frozenset({"io_pressure"})),
}
"""What starvation explains, by condition. docs/development/architecture.md has it as a table; a test compares them."""


def explanation(result: Result) -> Explanation | None:
    """How starvation can explain this bad result; None: it cannot."""
    if not result.level.bad or result.evidence.certain or result.evidence.conclusive:
        return None
    symptom = EXPLAINED.get(result.condition)
    if symptom is None or not result.evidence.in_time:
        return symptom
    return replace(symptom, by=symptom.by - {"cpu_high"})


def pressure_units(record: UnitRecord, view: TrackerView) -> list[UnitRecord]:
    """The pressure units whose results decide whether the unit's latest result is a separate fault."""
    if record.latest is None or explanation(record.latest) is None:
        return []
    return [view.units[name] for name in record.spec.starved_by]


def cause(record: UnitRecord, view: TrackerView) -> UnitRecord | None:
    """The pressure unit that explains the unit's latest result; the host's, if that explains the former, too."""
    symptom = explanation(record.latest) if record.latest is not None else None
    if symptom is None:
        return None
    for other in pressure_units(record, view):
        if other.starving is not None and other.starving.condition in symptom.by:
            return cause(other, view) or other
    return None


def undecided(record: UnitRecord) -> bool:
    """Whether the unit's latest result is a symptom that waits to be published."""
    waits = record.pending is not None and record.published.level is not Level.ERROR
    return waits and record.latest is not None and explanation(record.latest) is not None


def asked(record: UnitRecord, view: TrackerView, lasted: float) -> list[tuple[UnitRecord, float]]:
    """The pressure units that could explain the unit's latest result, which has lasted long enough since `lasted`, and when the
    run must have begun that decides: WARN_WAIT_S later while it may soon be ERROR with a condition that explains the symptom.
    """
    return [
        (other, lasted + (WARN_WAIT_S if _may_explain(other, record) else 0.0))
        for other in pressure_units(record, view)
    ]


def _may_explain(pressure_unit: UnitRecord, record: UnitRecord) -> bool:
    """Whether the pressure unit is WARN with a condition that explains the symptom and not falling, or its newest measurement is
    above the limit.
    """
    symptom = explanation(record.latest) if record.latest is not None else None
    result = pressure_unit.latest
    if symptom is None or result is None:
        return False
    warns = result.level is Level.WARN and result.condition in symptom.by and not result.evidence.falling
    return warns or result.evidence.rising


def predates(record: UnitRecord, pressure_unit: UnitRecord) -> bool:
    """Whether the unit's fault is older than the starvation, or has a cause that starvation does not explain."""
    if record.fault is None:
        return record.published_given_up
    since, symptom = (
        pressure_unit.starving.since if pressure_unit.starving is not None else 0.0,
        explanation(record.fault.result),
    )
    if symptom is None or (symptom.most_s is not None and record.fault.opened.mono >= since + symptom.most_s):
        return True
    return record.fault.opened.mono < since - BEFORE_PRESSURE_S


def outlasted(record: UnitRecord, now: float) -> bool:
    """Whether the unit's latest result is a symptom that lasts longer than starvation can explain."""
    symptom = explanation(record.latest) if record.latest is not None else None
    if symptom is None or symptom.most_s is None:
        return False
    return (
        record.published.level is Level.STALE
        and bool(record.published.blocked_by)
        and now - record.published.since.mono >= symptom.most_s
    )


def observe(record: UnitRecord, now: float) -> StarvationChange:
    """Record the latest result of a pressure unit: it explains symptoms until RECOVERY_S after its newest measurement above the
    limit, however long its report goes on.
    """
    was, latest = record.starving, record.latest
    assert latest is not None
    if latest.level is Level.ERROR and latest.condition in WAITING | {"pids_limit"}:
        below_from = (was.below_from or now) if was is not None and latest.evidence.falling else None
        lasts = not latest.evidence.falling if below_from is None else now - below_from < RECOVERY_S
        since = was.since if was is not None else now
        record.starving = Starvation(since, now, latest.condition, below_from) if lasts else None
        return _change(was, record.starving, now if below_from is None else below_from)
    if latest.level is not Level.STALE or (was is not None and now - was.seen >= UNKNOWN_PRESSURE_S):
        record.starving = None
    return _change(was, record.starving, now if was is None or was.below_from is None else was.below_from)


@dataclass(frozen=True, slots=True)
class StarvationChange:
    """What a result of a pressure unit has changed. below_from: since when nothing waits (monotonic seconds), of a starvation that ended."""

    began: bool = False
    ended: bool = False
    below_from: float = 0.0


def _change(was: Starvation | None, now: Starvation | None, below_from: float) -> StarvationChange:
    return StarvationChange(was is None and now is not None, was is not None and now is None, below_from)


def ended(record: UnitRecord, pressure_unit: str, below_from: float) -> None:
    """The starvation is over since `below_from`: earlier symptoms do not count, and new ones have time to disappear."""
    record.pressure_unit = pressure_unit
    record.symptoms_count_from = max(record.symptoms_count_from, below_from)
    record.symptom_grace_from = max(record.symptom_grace_from, below_from)
    record.pending = record.ok_since = None


def recovering(record: UnitRecord, now: float) -> bool:
    """Whether the unit's latest result is a symptom that may still follow from a past starvation."""
    symptom = explanation(record.latest) if record.latest is not None else None
    if record.latest is None or symptom is None:
        return False
    until = record.symptom_grace_from + symptom.recovery_s(record.spec.unit.grace_s)
    return now < until or record.started - record.latest.age_s < record.symptoms_count_from
