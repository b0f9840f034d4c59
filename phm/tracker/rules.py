"""The rules by which a unit's newest result becomes what is told: pure judgement, nothing is changed here.

`decide` applies them in the order in which they stand; the first that has a verdict decides.

So one cause raises one alarm, whatever order the evidence arrives in and whichever wake-up is lost, as long as
the evidence of the cause can be seen within the dependent's `settle_s`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from phm.core.model import ON_HOLD, Level, Result
from phm.tracker import starvation
from phm.tracker.units import Pending, TrackerView, UnitRecord

UNKNOWN_NEED_S = 10.0
"""How long a bad result waits for a need that is STALE at the moment."""
GRACE_ENDS_AFTER_OK_S = 2.5
"""Grace ends early once a unit has been OK for this long: shorter could be the memory of what was there before (a killed
node stays listed until its lease ends, 1 s with the profile in config/fastdds.xml)."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What follows for one unit.

    tell:       the result to publish; None: what is published stays.
    blocked_by: the unit whose fault `tell` follows from. An open fault of its own is then reattributed.
    pending:    what waits to be told; None: nothing does.
    ask:        units whose checks are to run again, now.
    """

    publish: Result | None = None
    blocked_by: str = ""
    pending: Pending | None = None
    rerun: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class RuleContext:
    """One unit's newest result at one moment (monotonic seconds), with all that the rules may look at."""

    record: UnitRecord
    result: Result
    view: TrackerView
    now: float


NO_CHANGE = Decision()


def decide(record: UnitRecord, view: TrackerView, now: float) -> Decision | None:
    """The verdict on the unit's newest result; None when there has been none."""
    if record.latest is None:
        return None
    context = RuleContext(record, record.latest, view, now)
    decisions = (rule(context) for rule in RULES)
    return next((decision for decision in decisions if decision is not None), NO_CHANGE)


def recovered(context: RuleContext) -> Decision | None:
    """1. OK is told at once, and closes the unit's fault.

    Except while its own fault is under repair: it counts when the repair is proven, dependents included. Where it was not,
    when these are back all the same, or `UnitRecord.unproven_until` is over.
    """
    if context.result.level is not Level.OK:
        return None
    return NO_CHANGE if _unproven(context.record, context) else Decision(context.result)


def action_in_progress(context: RuleContext) -> Decision | None:
    """2. A bad result while an action is at work on the unit's target follows from that action.

    The unit is STALE `blocked_by` the fault under repair; a unit whose own fault is open stays as it is.
    """
    action = context.view.actions.get(context.record.target)
    if action is None or not context.result.level.bad:
        return None
    if context.record.fault is None and context.record.id != action.owner:
        return _blocked(context, action.owner)
    return NO_CHANGE


def on_hold(context: RuleContext) -> Decision | None:
    """3. A bad result of a target on hold is STALE, with until when, by whom and why. An open fault stays open meanwhile."""
    hold = context.view.holds.get(context.record.target)
    if hold is None or not context.result.level.bad:
        return None
    known = context.record.fault is not None or context.record.published_given_up
    if hold.conditions and (known or context.result.condition not in hold.conditions):
        return None
    summary, brief = f"{hold.words}; {context.result.summary}", f"{context.record.target} on hold"
    return Decision(replace(context.result, level=Level.STALE, summary=summary, brief=brief, condition=ON_HOLD))


def blocked(context: RuleContext) -> Decision | None:
    """4. A result that is not OK while something the unit needs is bad is a consequence: STALE `blocked_by` the first cause.

    If it had been told as a fault of its own, that fault is closed as reattributed; to a unit that is not published yet, since
    it has grace or may follow from starvation, only when that is decided. What is bad by starvation alone is no cause here (5).
    """
    cause = _cause(context)
    if not cause:
        return None
    causing = context.view.units[cause]
    undecided = context.record.fault is not None and (starvation.undecided(causing) or in_grace(causing, context.now))
    return NO_CHANGE if undecided or cause == context.record.id else _blocked(context, cause)


def starved(context: RuleContext) -> Decision | None:
    """5. A symptom that starvation explains (`phm.tracker.starvation`) is STALE `blocked_by` the pressure unit while that is ERROR.

    When it is over, symptoms get time to go; what is still there then is a fault of its own. A fault that was open before
    goes on; one that was published just before is reattributed. What is not explained is blocked by a need that is bad by
    starvation alone, unless it is conclusive: that is judged as ever.
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
    """6. STALE is published immediately and closes nothing: unknown does not mean recovered."""
    return Decision(context.result) if context.result.level is Level.STALE else None


def being_stopped(context: RuleContext) -> Decision | None:
    """7. What breaks in a container that was given a signal to end and time for it goes with it, and is not a fault.

    Until the container has ended, or its time for it is over. A fault that is open already goes on.
    """
    record = context.record
    if not context.view.stopping(record.target, context.now) or not context.view.is_part(record.id):
        return None
    if _known(record):
        return NO_CHANGE
    summary = f"{record.target} is being stopped: {context.result.summary}"
    return Decision(replace(context.result, level=Level.STALE, summary=summary, brief="", condition=""))


def grace(context: RuleContext) -> Decision | None:
    """8. A bad result during grace is `not known yet`, unless its check is certain of it.

    Grace ends early when the unit has been OK for SURE_S, or its `memory_s` where that is longer.
    What was seen before the grace began never counts again: the unit is run anew. It begins with PHM itself; after a
    repair, for the target and all that needs it; after an ERROR, told or not, for all that need the unit: what looked
    bad meanwhile may follow from it; and once for each new life of a
    container (`phm.tracker.start_dedup`), for all that need it. A container that never comes well is told by its own check.
    """
    if not in_grace(context.record, context.now):
        return None
    return Decision(as_unknown(context.result))


def confirmed(context: RuleContext) -> Decision:
    """9. Otherwise everything that the unit needs is run again, and the pressure units that could explain a symptom.

    A bad result is told only when it was bad `failures` times in a row, has lasted `settle_s` (the result's own, or else
    its unit's), and each need, and with `settle_s` the unit too, has answered in a run that began after that. Needs that
    are STALE may be the cause: they get UNKNOWN_S to be known, not for ever. So do pressure units to answer; one that cannot
    tell explains nothing. What was seen before a need changed says nothing about now.
    """
    record, unit = context.record, context.record.spec.unit
    if record.published.level is context.result.level and not record.published.blocked_by and not record.new_condition:
        return Decision(context.result)
    upstream, symptom = context.view.upstream(record.id), starvation.explanation(context.result)
    pending, rerun = record.pending, frozenset[str]()
    if pending is None:
        pending, rerun = Pending(context.now), frozenset(other.id for other in upstream)
    settle_s = unit.settle_s if context.result.settle_s is None else context.result.settle_s
    lasted = pending.since + (max(settle_s, symptom.settle_s) if symptom is not None else settle_s)
    if context.now < lasted:
        return Decision(pending=pending, rerun=rerun)
    witnesses = (record, *upstream) if settle_s > 0 else upstream
    unanswered = frozenset(other.id for other in witnesses if other.started < lasted) | _unasked(context, lasted)
    if not pending.requested:
        pending, rerun = replace(pending, requested=True), rerun | unanswered
    unknown = context.now - pending.since < UNKNOWN_NEED_S and any(other.unknown for other in upstream)
    rising = context.now < lasted + starvation.WARN_WAIT_S and starvation.may_become_explained(record, context.view)
    if any(other.published.since.mono > record.started for other in upstream):
        return Decision(pending=pending, rerun=rerun | {record.id})
    if unanswered or unknown or rising or record.bad_in_a_row < record.spec.failures:
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
    """A bad result that may be incomplete."""
    return replace(result, level=Level.STALE, summary=f"not known yet: {result.summary}", brief="", condition="")


def in_grace(record: UnitRecord, now: float) -> bool:
    """Whether the unit has grace. An open or given-up fault goes on meanwhile."""
    known = record.fault is not None or (record.published_given_up and not record.new_condition)
    certain = record.latest is not None and record.latest.evidence.certain
    return not known and ((now < record.grace_until and not certain) or record.started < record.valid_from)


def _unproven(record: UnitRecord, context: RuleContext) -> bool:
    """Whether the unit's fault, open or given up, is still being proven to be healed, or was not: its OK is kept back."""
    if record.fault is None and not record.escalated:
        return False
    action = context.view.actions.get(record.target)
    proving = action is not None and action.proving and action.owner == record.id
    return proving or (context.now < record.unverified_until and not _all_back(record, context.view))


def _all_back(record: UnitRecord, view: TrackerView) -> bool:
    """Whether all of its target that needs the unit has been found OK since its repair was not proven: late, but back."""
    below = (other for other in view.downstream(record.id) if other.target == record.target and not _known(other))
    return all(
        other.latest is not None and other.latest.level is Level.OK and other.started >= record.unverified_from
        for other in below
    )


def _unasked(context: RuleContext, lasted: float) -> frozenset[str]:
    """Pressure units that could explain the result, and have not answered since."""
    if context.now >= lasted + UNKNOWN_NEED_S:
        return frozenset()
    return frozenset(
        other.id for other in starvation.pressure_units(context.record, context.view) if other.started < lasted
    )


def _known(record: UnitRecord) -> bool:
    """Published as a fault: open, or given up."""
    return record.fault is not None or record.published_given_up


def _cause(context: RuleContext, *, by_starvation: bool = False) -> str:
    """The first unit upstream that is failing, by starvation alone or not, or whose OK is kept back: grace for what needs it
    begins when that is told.

    If that one is under repair, the fault being repaired.
    """
    for other in context.view.upstream(context.record.id):
        if (other.failing or _unproven(other, context)) and _merely_starved(other, context) is by_starvation:
            action = context.view.actions.get(other.target)
            return action.owner if action is not None and other.fault is None else other.id
    return ""


def _merely_starved(other: UnitRecord, context: RuleContext) -> bool:
    if _known(other):
        return False
    return starvation.cause(other, context.view) is not None or starvation.recovering(other, context.now)


def _blocked(context: RuleContext, cause: str) -> Decision:
    summary = f"blocked by {cause}: {context.result.summary}"
    return Decision(replace(context.result, level=Level.STALE, summary=summary), blocked_by=cause)
