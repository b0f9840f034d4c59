"""The rules that decide what is published about a unit's latest result. Pure: they change nothing.

`decide` applies them in order; the first that returns a decision wins. As a result, one cause raises one alarm, whatever the
order of the evidence and even if a wake-up is lost, as long as the cause can be observed within the dependent's `settle_s`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from phm.core.model import ON_HOLD, Evidence, Level, Result
from phm.tracker import starvation
from phm.tracker.units import ActionInProgress, Pending, TrackerView, UnitRecord

UNKNOWN_NEED_S = 12.0
"""How long a bad result waits for a dependency that is STALE: longer than a node that left the graph is unknown while its process runs
(`phm_checks._liveness`)."""
UNANSWERED_S = 10.0
"""How long a symptom waits for the answer of a pressure unit."""
NETWORK, ENDED = "network/", "node_missing"
"""Units of networks, and the condition of a node that has ended: with conclusive evidence it is known from the Docker
Engine, and no consequence of a network. So is a result with certain evidence. Other conclusive results may be one, of a node that runs:
its source may be on that network."""
STOPPED = "node_hung"
"""The condition of a node whose process is stopped, if that is certain."""
ENGINE, CONTAINER = "engine", "container/"
"""The unit of the Docker Engine, and units of containers."""
DETACHED, RECONNECTS = "disconnected", "reconnect"
"""The condition of a container that is not on its network, known from the Docker Engine if the evidence is conclusive,
and the action that takes a container off its networks for a moment."""
FROM_OUTSIDE = frozenset({"network_missing", "device_missing", "sidecar_disconnected"})
"""Conditions that come from outside of every container: no action on one causes them, except that a program may reset its device when it
starts, which is a fault at any start. Not taken for a consequence of an action in progress (rule 2), nor of a container whose OK is held
back (rule 4)."""
ONE_PART = frozenset({"relaunch", "restore_file"})
"""Actions on one node or on files: they end no process of another node."""
GRACE_ENDS_AFTER_OK_S = 2.5
"""Grace ends early once a unit has been OK for this long. Shorter could be a remnant of the previous run (a killed node stays
listed until its lease ends, 1 s with the profile in config/fastdds.xml)."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What to do about one unit.

    publish:    the result to publish; None: the published state stays.
    blocked_by: the unit that causes `publish`. An open fault of the unit itself is then reattributed.
    pending:    the result that waits for confirmation; None: none.
    rerun:      units whose checks run again now.
    """

    publish: Result | None = None
    blocked_by: str = ""
    pending: Pending | None = None
    rerun: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class RuleContext:
    """One unit's latest result at one moment (monotonic seconds), with everything that the rules may read."""

    record: UnitRecord
    result: Result
    view: TrackerView
    now: float


NO_CHANGE = Decision()
NO_EVIDENCE = Evidence()


def decide(record: UnitRecord, view: TrackerView, now: float) -> Decision | None:
    """The decision about the unit's latest result; None if there is no result."""
    if record.latest is None:
        return None
    context = RuleContext(record, record.latest, view, now)
    for rule in RULES:
        decision = rule(context)
        if decision is not None:
            return decision
    return NO_CHANGE


def recovered(context: RuleContext) -> Decision | None:
    """1. OK is published immediately and closes the unit's fault. So is a WARN that states that it is over
    (`Result.ends_fault`).

    Except while recovery works on its own fault: then it counts once the recovery is verified, dependents included; if that
    failed, once the dependents are back or `UnitRecord.unverified_until` has passed.
    """
    known = context.record.fault is not None or context.record.escalated
    if context.result.level is not Level.OK and not (context.result.ends_fault and known):
        return None
    return NO_CHANGE if _unverified(context.record, context) else Decision(context.result)


def action_in_progress(context: RuleContext) -> Decision | None:
    """2. A bad result during a recovery action on the unit's target follows from that action.

    The unit is STALE `blocked_by` the fault being recovered; a unit with an open fault stays unchanged. Except that the Docker
    Engine no longer lists the running container on its network: of the actions only RECONNECTS does that. And except what was certain
    before an action that leaves its target running, what is certain about another part than that of an action on ONE_PART, and what
    comes FROM_OUTSIDE. An action without a fault was requested: its unit is STALE.
    """
    record, action = context.record, context.view.actions.get(context.record.target)
    if action is None or not context.result.level.bad:
        return None
    if _detached(context) and action.action != RECONNECTS:
        return None
    if record.fault is not None or (record.id == action.owner and record.escalated):
        return NO_CHANGE
    if record.id == action.owner:
        summary = f"{record.target} is being restarted on request: {context.result.summary}"
        return Decision(replace(context.result, level=Level.STALE, summary=summary, brief="", condition=""))
    separate = (
        context.result.condition in FROM_OUTSIDE
        or certain_before(record, action)
        or _stopped_meanwhile(context, action)
        or _of_another_part(context, action)
    )
    return None if separate else _blocked(context, action.owner)


def on_hold(context: RuleContext) -> Decision | None:
    """3. A bad result of a target on hold is STALE, with end, owner and reason of the hold. An open fault stays open."""
    hold = context.view.holds.get(context.record.target)
    if hold is None or not context.result.level.bad:
        return None
    known = context.record.fault is not None or context.record.published_given_up
    if hold.conditions and (known or context.result.condition not in hold.conditions):
        return None
    summary, brief = f"{hold.words}; {context.result.summary}", f"{context.record.target} on hold"
    return Decision(replace(context.result, level=Level.STALE, summary=summary, brief=brief, condition=ON_HOLD))


def blocked(context: RuleContext) -> Decision | None:
    """4. A result that is not OK while a dependency is bad is a consequence: STALE `blocked_by` the first cause.

    An open fault of the unit is closed as reattributed. If the cause is not published yet, because it is being confirmed (a single
    failed run may be no fault), is in grace or may follow from starvation, or if the dependency is down because recovery acts on
    it for another unit, only once that is decided.
    Dependencies that are bad by starvation alone are handled by rule 5. A network does not explain that a process has ended or is
    stopped: that is a separate fault, also behind a lost network.
    """
    cause = _cause(context)
    if not cause:
        return None
    causing = context.view.units[cause]
    confirming = causing.pending is not None and causing.published.level is not Level.ERROR
    undecided = context.record.fault is not None and (
        confirming or starvation.undecided(causing) or in_grace(causing, context.now) or _acted_on(context)
    )
    if undecided or cause == context.record.id:
        return NO_CHANGE
    decision = _blocked(context, cause)
    # If the cause turns out to be none, the wait goes on: else a cause that fails now and then would hide this result for good.
    return replace(decision, pending=context.record.pending) if confirming else decision


def starved(context: RuleContext) -> Decision | None:
    """5. A symptom that starvation explains (`phm.tracker.starvation`) is STALE `blocked_by` the pressure unit while that is ERROR.

    Afterwards symptoms get time to disappear; those that remain are separate faults. A fault that was open before stays open;
    one published just before is reattributed. A result that starvation does not explain is blocked by a dependency that is bad
    by starvation alone, unless its evidence is conclusive.
    """
    record, cause = context.record, starvation.cause(context.record, context.view)
    if cause is not None and starvation.outlasted(record, context.now):
        return None
    if cause is not None:
        return NO_CHANGE if starvation.predates(record, cause) else _blocked(context, cause.id)
    if starvation.recovering(record, context.now) and not _known(record):
        return Decision(as_unknown(context.result))
    if context.result.evidence.conclusive:
        return None
    above = _cause(context, by_starvation=True)
    if not above:
        return None
    return NO_CHANGE if _known(record) else _blocked(context, above)


def unknown(context: RuleContext) -> Decision | None:
    """6. STALE is published immediately and closes no fault: unknown does not mean recovered."""
    return Decision(context.result) if context.result.level is Level.STALE else None


def being_stopped(context: RuleContext) -> Decision | None:
    """7. What fails in a container that received a stop signal is part of the stop and not a fault.

    Until the container has exited or its stop timeout is over. An open fault stays open.
    """
    record = context.record
    if not context.view.stopping(record.target, context.now) or not context.view.is_part(record.id):
        return None
    if _known(record):
        return NO_CHANGE
    summary = f"{record.target} is being stopped: {context.result.summary}"
    return Decision(replace(context.result, level=Level.STALE, summary=summary, brief="", condition=""))


def grace(context: RuleContext) -> Decision | None:
    """8. A bad result during grace is `not known yet`, unless its evidence is certain.

    Grace begins when PHM starts; after a recovery action, for the target and its dependents; after an ERROR, for the dependents,
    but after one that was never published only once until the dependent was OK; and once per container start
    (`phm.tracker.start_dedup`), for the dependents. Results from before never count. Grace ends early when the unit has been OK
    for GRACE_ENDS_AFTER_OK_S, or for its `memory_s` if longer. A container that never becomes healthy is reported by its own
    check.
    """
    if not in_grace(context.record, context.now):
        return None
    return Decision(as_unknown(context.result))


def confirmed(context: RuleContext) -> Decision:
    """9. Otherwise all dependencies run again, and the pressure units that could explain a symptom.

    A bad result is published once it was bad `failures` times in a row, has lasted `settle_s` (of the result, else of the unit),
    and every dependency that can explain it (with `settle_s` also the unit) has a result of a run that began after that. Dependencies that are
    STALE may be the cause, so they and their answers are waited for, for UNKNOWN_NEED_S at most: a check that hangs never answers.
    Pressure units are waited for, too, for UNANSWERED_S, but one that is STALE explains nothing, and of one that may soon explain it
    the result must be of a run that began WARN_WAIT_S later. Results from before a dependency changed do not count.
    """
    record, unit = context.record, context.record.spec.unit
    if record.published.level is context.result.level and not record.published.blocked_by and not record.new_condition:
        return Decision(context.result)
    upstream, symptom = _possible_causes(context), starvation.explanation(context.result)
    pending, rerun = record.pending, frozenset[str]()
    if pending is None:
        pending, rerun = Pending(context.now), frozenset(other.id for other in upstream)
    settle_s = unit.settle_s if context.result.settle_s is None else context.result.settle_s
    lasted = pending.since + (max(settle_s, symptom.settle_s) if symptom is not None else settle_s)
    if context.now < lasted:
        return Decision(pending=pending, rerun=rerun)
    witnesses = (record, *upstream) if settle_s > 0 else upstream
    overdue = context.now - pending.since >= UNKNOWN_NEED_S
    unanswered = frozenset(
        other.id for other in witnesses if other.started < lasted and not (overdue and other.unknown)
    ) | _unasked(context, lasted)
    if not pending.requested:
        pending, rerun = replace(pending, requested=True), rerun | unanswered
    waits_for_unknown = not overdue and any(other.unknown for other in upstream)
    if record.started < pending.again_from or any(other.published.since.mono > record.started for other in upstream):
        return Decision(pending=pending, rerun=rerun | {record.id})
    if unanswered or waits_for_unknown or record.bad_in_a_row < record.spec.failures:
        return Decision(pending=pending, rerun=rerun)
    return Decision(context.result, rerun=rerun)


RULES: tuple[Callable[[RuleContext], Decision | None], ...] = (
    recovered,
    action_in_progress,
    on_hold,
    blocked,
    starved,
    unknown,
    being_stopped,
    grace,
    confirmed,
)


def as_unknown(result: Result) -> Result:
    """The bad result as STALE, because its evidence may be incomplete."""
    return replace(result, level=Level.STALE, summary=f"not known yet: {result.summary}", brief="", condition="")


def in_grace(record: UnitRecord, now: float) -> bool:
    """Whether the unit is in grace. An open or given-up fault is not affected."""
    known = record.fault is not None or (record.published_given_up and not record.new_condition)
    evidence = record.latest.evidence if record.latest is not None else NO_EVIDENCE
    from_before = min(record.started, evidence.observed) < record.valid_from
    return not known and (from_before or (now < record.grace_until and not evidence.certain))


def certain_before(record: UnitRecord, action: ActionInProgress) -> bool:
    """Whether the unit has been bad with certainty, in this run of its target, since before an action that leaves that running."""
    since = record.certain_since
    return action.leaves_running and since is not None and record.valid_from <= since < action.begun


def _stopped_meanwhile(context: RuleContext, action: ActionInProgress) -> bool:
    """Whether a process is stopped during an action that leaves it running: no action stops one by a signal without ending it."""
    record = context.record
    since = record.certain_since
    stopped = action.leaves_running and context.result.condition == STOPPED
    return stopped and since is not None and since >= record.valid_from


def _of_another_part(context: RuleContext, action: ActionInProgress) -> bool:
    """Whether the unit is bad with certainty, in this run of its target, while one of ONE_PART is done to another part of that."""
    record = context.record
    since, node = record.certain_since, record.spec.unit.node
    same = bool(node) and node == context.view.units[action.owner].spec.unit.node
    return action.action in ONE_PART and not same and since is not None and since >= record.valid_from


def _unverified(record: UnitRecord, context: RuleContext) -> bool:
    """Whether the recovery of the unit's fault, open or given up, is still being verified or failed verification; its OK is not
    published."""
    if record.fault is None and not record.escalated:
        return False
    # By its owner: the action may be on another container, for a unit that names its target only in its results.
    verifying = any(action.verifying and action.owner == record.id for action in context.view.actions.values())
    return verifying or (context.now < record.unverified_until and not _all_back(record, context.view))


def _all_back(record: UnitRecord, view: TrackerView) -> bool:
    """Whether all dependents that wait for its recovery have been found OK since the verification of that failed."""
    return all(
        other.latest is not None and other.latest.level is Level.OK and other.started >= record.unverified_from
        for other in view.waiting_for(record.id)
    )


def _unasked(context: RuleContext, lasted: float) -> frozenset[str]:
    """Pressure units that could explain the result and have no result that is new enough."""
    if context.now >= lasted + UNANSWERED_S:
        return frozenset()
    return frozenset(
        other.id for other, needed in starvation.asked(context.record, context.view, lasted) if other.started < needed
    )


def _detached(context: RuleContext) -> bool:
    """Whether the engine lists the running container, without its network."""
    result = context.result
    return context.record.id.startswith(NETWORK) and result.condition == DETACHED and result.evidence.conclusive


def _known(record: UnitRecord) -> bool:
    """Whether it is published as a fault: open, or given up."""
    return record.fault is not None or record.published_given_up


def _cause(context: RuleContext, *, by_starvation: bool = False) -> str:
    """The first dependency that is failing (by starvation alone or not) or whose OK is held back. That a running container is not on its
    network, and what comes FROM_OUTSIDE, does not follow from a container whose OK is only held back.

    If recovery works on that one, the unit whose fault is being recovered.
    """
    other = _dependency(context, by_starvation=by_starvation)
    if other is None:
        return ""
    action = context.view.actions.get(other.target)
    return action.owner if action is not None and other.fault is None else other.id


def _dependency(context: RuleContext, *, by_starvation: bool = False) -> UnitRecord | None:
    held_back = not _detached(context) and context.result.condition not in FROM_OUTSIDE
    for other in _possible_causes(context):
        if (other.failing or (held_back and _unverified(other, context))) and _merely_starved(
            other, context
        ) is by_starvation:
            return other
    return None


def _acted_on(context: RuleContext) -> bool:
    """Whether the dependency is failing because recovery acts on its target for the fault of another unit."""
    other = _dependency(context)
    return other is not None and other.fault is None and other.target in context.view.actions


def _possible_causes(context: RuleContext) -> list[UnitRecord]:
    """The dependencies that can explain the result.

    A network does not explain that a process has ended or is stopped, nor that it is unknown whether such a fault is over. An engine
    that does not respond explains what is unknown, but neither a container that is known to be down without it or since before, nor
    what depends on that one.
    """
    fault, upstream = context.record.fault, context.view.upstream(context.record.id)
    reported = fault is not None and not context.result.level.bad and _has_ended(fault.result)
    ended = reported or _has_ended(context.result)
    down = any(_known_down(other) for other in (context.record, *upstream))
    return [
        other
        for other in upstream
        if not (ended and other.id.startswith(NETWORK)) and not (down and other.id == ENGINE)
    ]


def _has_ended(result: Result) -> bool:
    """Whether it states that a process has ended or is stopped, by evidence from the Docker Engine."""
    return result.evidence.certain or (result.evidence.conclusive and result.condition == ENDED)


def _known_down(record: UnitRecord) -> bool:
    """Whether it is a container that has been reported as down, or is down by evidence of which the engine is not the source
    (`phm_checks.container`)."""
    latest = record.latest if record.id.startswith(CONTAINER) else None
    if latest is None or latest.level is not Level.ERROR:
        return False
    return latest.evidence.conclusive or _known(record)


def _merely_starved(other: UnitRecord, context: RuleContext) -> bool:
    if _known(other):
        return False
    return starvation.cause(other, context.view) is not None or starvation.recovering(other, context.now)


def _blocked(context: RuleContext, cause: str) -> Decision:
    published = context.record.published
    if context.record.published_from is context.result and published.blocked_by == cause:
        return Decision(published.result, blocked_by=cause)  # made before: this is asked several times a second
    summary = f"blocked by {cause}: {context.result.summary}"
    return Decision(replace(context.result, level=Level.STALE, summary=summary), blocked_by=cause)
