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

    tell: Result | None = None
    blocked_by: str = ""
    pending: Pending | None = None
    ask: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class RuleContext:
    """One unit's newest result at one moment (monotonic seconds), with all that the rules may look at."""

    entry: UnitRecord
    result: Result
    scene: TrackerView
    now: float


NO_CHANGE = Decision()


def decide(entry: UnitRecord, scene: TrackerView, now: float) -> Decision | None:
    """The verdict on the unit's newest result; None when there has been none."""
    if entry.raw is None:
        return None
    look = RuleContext(entry, entry.raw, scene, now)
    verdicts = (rule(look) for rule in RULES)
    return next((verdict for verdict in verdicts if verdict is not None), NO_CHANGE)


def recovered(look: RuleContext) -> Decision | None:
    """1. OK is told at once, and closes the unit's fault.

    Except while its own fault is under repair: it counts when the repair is proven, dependents included. Where it was not,
    when these are back all the same, or `UnitRecord.unproven_until` is over.
    """
    if look.result.level is not Level.OK:
        return None
    return NO_CHANGE if _unproven(look.entry, look) else Decision(look.result)


def action_in_progress(look: RuleContext) -> Decision | None:
    """2. A bad result while an action is at work on the unit's target follows from that action.

    The unit is STALE `blocked_by` the fault under repair; a unit whose own fault is open stays as it is.
    """
    hold = look.scene.holds.get(look.entry.target)
    if hold is None or not look.result.level.bad:
        return None
    if look.entry.fault is None and look.entry.id != hold.owner:
        return _blocked(look, hold.owner)
    return NO_CHANGE


def on_hold(look: RuleContext) -> Decision | None:
    """3. A bad result of a target on hold is STALE, with until when, by whom and why. An open fault stays open meanwhile."""
    pause = look.scene.pauses.get(look.entry.target)
    if pause is None or not look.result.level.bad:
        return None
    known = look.entry.fault is not None or look.entry.published_given_up
    if pause.conditions and (known or look.result.condition not in pause.conditions):
        return None
    summary, brief = f"{pause.words}; {look.result.summary}", f"{look.entry.target} on hold"
    return Decision(replace(look.result, level=Level.STALE, summary=summary, brief=brief, condition=ON_HOLD))


def blocked(look: RuleContext) -> Decision | None:
    """4. A result that is not OK while something the unit needs is bad is a consequence: STALE `blocked_by` the first cause.

    If it had been told as a fault of its own, that fault is closed as reattributed; to a unit that is not published yet, since
    it has grace or may follow from starvation, only when that is decided. What is bad by starvation alone is no cause here (5).
    """
    cause = _cause(look)
    if not cause:
        return None
    causing = look.scene.units[cause]
    undecided = look.entry.fault is not None and (starvation.undecided(causing) or in_grace(causing, look.now))
    return NO_CHANGE if undecided or cause == look.entry.id else _blocked(look, cause)


def starved(look: RuleContext) -> Decision | None:
    """5. A symptom that starvation explains (`phm.tracker.starvation`) is STALE `blocked_by` the pressure unit while that is ERROR.

    When it is over, symptoms get time to go; what is still there then is a fault of its own. A fault that was open before
    goes on; one that was published just before is reattributed. What is not explained is blocked by a need that is bad by
    starvation alone, unless it is conclusive: that is judged as ever.
    """
    entry, cause = look.entry, starvation.cause(look.entry, look.scene)
    if cause is not None and starvation.outlasted(entry, look.now):
        return None
    if cause is not None:
        return NO_CHANGE if starvation.predates(entry, cause) else _blocked(look, cause.id)
    if starvation.recovering(entry, look.now) and not _known(entry):
        return Decision(as_unknown(look.result))
    if look.result.evidence.conclusive:
        return None
    above = _cause(look, by_starvation=True)
    if not above:
        return None
    return NO_CHANGE if _known(entry) else _blocked(look, above)


def unknown(look: RuleContext) -> Decision | None:
    """6. STALE is published immediately and closes nothing: unknown does not mean recovered."""
    return Decision(look.result) if look.result.level is Level.STALE else None


def being_stopped(look: RuleContext) -> Decision | None:
    """7. What breaks in a container that was given a signal to end and time for it goes with it, and is not a fault.

    Until the container has ended, or its time for it is over. A fault that is open already goes on.
    """
    entry = look.entry
    if not look.scene.stopping(entry.target, look.now) or not look.scene.is_part(entry.id):
        return None
    if _known(entry):
        return NO_CHANGE
    summary = f"{entry.target} is being stopped: {look.result.summary}"
    return Decision(replace(look.result, level=Level.STALE, summary=summary, brief="", condition=""))


def grace(look: RuleContext) -> Decision | None:
    """8. A bad result during grace is `not known yet`, unless its check is certain of it.

    Grace ends early when the unit has been OK for SURE_S, or its `memory_s` where that is longer.
    What was seen before the grace began never counts again: the unit is run anew. It begins with PHM itself; after a
    repair, for the target and all that needs it; after an ERROR, told or not, for all that need the unit: what looked
    bad meanwhile may follow from it; and once for each new life of a
    container (`phm.tracker.start_dedup`), for all that need it. A container that never comes well is told by its own check.
    """
    if not in_grace(look.entry, look.now):
        return None
    return Decision(as_unknown(look.result))


def confirmed(look: RuleContext) -> Decision:
    """9. Otherwise everything that the unit needs is run again, and the pressure units that could explain a symptom.

    A bad result is told only when it was bad `failures` times in a row, has lasted `settle_s` (the result's own, or else
    its unit's), and each need, and with `settle_s` the unit too, has answered in a run that began after that. Needs that
    are STALE may be the cause: they get UNKNOWN_S to be known, not for ever. So do pressure units to answer; one that cannot
    tell explains nothing. What was seen before a need changed says nothing about now.
    """
    entry, unit = look.entry, look.entry.spec.unit
    if entry.told.level is look.result.level and not entry.told.blocked_by and not entry.anew:
        return Decision(look.result)
    upstream, symptom = look.scene.upstream(entry.id), starvation.explanation(look.result)
    pending, ask = entry.pending, frozenset[str]()
    if pending is None:
        pending, ask = Pending(look.now), frozenset(other.id for other in upstream)
    settle_s = unit.settle_s if look.result.settle_s is None else look.result.settle_s
    lasted = pending.since + (max(settle_s, symptom.settle_s) if symptom is not None else settle_s)
    if look.now < lasted:
        return Decision(pending=pending, ask=ask)
    witnesses = (entry, *upstream) if settle_s > 0 else upstream
    silent = frozenset(other.id for other in witnesses if other.started < lasted) | _unasked(look, lasted)
    if not pending.asked:
        pending, ask = replace(pending, asked=True), ask | silent
    unknown = look.now - pending.since < UNKNOWN_NEED_S and any(other.unknown for other in upstream)
    rising = look.now < lasted + starvation.WARN_WAIT_S and starvation.may_become_explained(entry, look.scene)
    if any(other.told.since.mono > entry.started for other in upstream):
        return Decision(pending=pending, ask=ask | {entry.id})
    if silent or unknown or rising or entry.bad_in_a_row < entry.spec.failures:
        return Decision(pending=pending, ask=ask)
    return Decision(look.result, ask=ask)


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


def in_grace(entry: UnitRecord, now: float) -> bool:
    """Whether the unit has grace. An open or given-up fault goes on meanwhile."""
    known = entry.fault is not None or (entry.published_given_up and not entry.anew)
    certain = entry.raw is not None and entry.raw.evidence.certain
    return not known and ((now < entry.grace_until and not certain) or entry.started < entry.valid_from)


def _unproven(entry: UnitRecord, look: RuleContext) -> bool:
    """Whether the unit's fault, open or given up, is still being proven to be healed, or was not: its OK is kept back."""
    if entry.fault is None and not entry.escalated:
        return False
    hold = look.scene.holds.get(entry.target)
    proving = hold is not None and hold.proving and hold.owner == entry.id
    return proving or (look.now < entry.unverified_until and not _all_back(entry, look.scene))


def _all_back(entry: UnitRecord, scene: TrackerView) -> bool:
    """Whether all of its target that needs the unit has been found OK since its repair was not proven: late, but back."""
    below = (other for other in scene.downstream(entry.id) if other.target == entry.target and not _known(other))
    return all(
        other.raw is not None and other.raw.level is Level.OK and other.started >= entry.unverified_from
        for other in below
    )


def _unasked(look: RuleContext, lasted: float) -> frozenset[str]:
    """Pressure units that could explain the result, and have not answered since."""
    if look.now >= lasted + UNKNOWN_NEED_S:
        return frozenset()
    return frozenset(other.id for other in starvation.pressure_units(look.entry, look.scene) if other.started < lasted)


def _known(entry: UnitRecord) -> bool:
    """Published as a fault: open, or given up."""
    return entry.fault is not None or entry.published_given_up


def _cause(look: RuleContext, *, by_starvation: bool = False) -> str:
    """The first unit upstream that is failing, by starvation alone or not, or whose OK is kept back: grace for what needs it
    begins when that is told.

    If that one is under repair, the fault being repaired.
    """
    for other in look.scene.upstream(look.entry.id):
        if (other.failing or _unproven(other, look)) and _merely_starved(other, look) is by_starvation:
            hold = look.scene.holds.get(other.target)
            return hold.owner if hold is not None and other.fault is None else other.id
    return ""


def _merely_starved(other: UnitRecord, look: RuleContext) -> bool:
    if _known(other):
        return False
    return starvation.cause(other, look.scene) is not None or starvation.recovering(other, look.now)


def _blocked(look: RuleContext, cause: str) -> Decision:
    summary = f"blocked by {cause}: {look.result.summary}"
    return Decision(replace(look.result, level=Level.STALE, summary=summary), blocked_by=cause)
