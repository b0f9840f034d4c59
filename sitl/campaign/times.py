"""The times of one fault, by the definitions of docs/development/campaign.md, and what has ended it. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.campaign.statustext import reports
from sitl.campaign.trial import OFF, Alarm, RaisedWarning, Start, Trial
from sitl.campaign.verdict import ACTION, DOCKER, INJECTOR, ITSELF, PHM, Verdict, places, until as cleared

OWN_RESTART, OWN_GUARD, NOTHING = "its own restart", "its own guard", "itself"
INTERVAL_S = 20.0
"""Between two periodic reports, where the trial does not say it."""
STEPS = ("advised", "refused", "done", "failed", "verified", "escalated")
"""Phases with which a step of PHM's response to a fault is complete."""
SUSPENDED = "phm_suspended"
"""A suspension of PHM is reported when it is over."""


def measure(verdict: Verdict, trial: Trial, first: Sequence[Alarm | RaisedWarning]) -> None:
    """Set all times of the verdict. `first`: alarms or warnings at the fault's own unit. A fault that explains others
    must be measured before them.
    """
    fault = verdict.injection
    begun = fault.moment or 0.0
    until = cleared(fault)
    if fault.world is not None and fault.world <= until:
        verdict.world_s = max(0.0, fault.world - begun)
    if fault.unit:
        _reported(verdict, trial, first, begun, until)
        if trial.kind != OFF:
            _claim(verdict, trial, begun, until)
    else:
        _restarted(verdict, trial, begun, until)
    if verdict.claimed_s is not None:
        verdict.ended_by = _ended_by(verdict, trial, begun)
    _logged(verdict, trial, begun, until)
    _published(verdict, trial, begun)


def _reported(
    verdict: Verdict, trial: Trial, first: Sequence[Alarm | RaisedWarning], begun: float, until: float
) -> None:
    if not first:
        return
    verdict.detected_s = first[0].mono - begun
    lines = [
        line.mono
        for line in trial.lines
        if begun <= line.mono <= until and reports(line, verdict.injection, first[0], trial)
    ]
    verdict.response_s = min(lines) - begun if lines else None


def _restarted(verdict: Verdict, trial: Trial, begun: float, until: float) -> None:
    """PHM itself was down: its next run reports by its first line, and is complete with its first complete report."""
    agent = verdict.injection.agent
    start = next((each for each in trial.starts if each.agent == agent and begun <= each.mono <= until), None)
    if start is None:
        return
    verdict.detected_s = start.mono - begun
    lines = [line.mono for line in trial.lines if line.system == agent and start.mono <= line.mono <= until]
    verdict.response_s = min(lines) - begun if lines else None
    _complete_again(verdict, start, begun, until)


def _complete_again(verdict: Verdict, start: Start, begun: float, until: float) -> None:
    if start.report is not None and start.report <= until:
        verdict.claimed_s, verdict.by = start.report - begun, OWN_RESTART


def _claim(verdict: Verdict, trial: Trial, begun: float, until: float) -> None:
    """By PHM's record it was over before it was cleared: verified by an action, or closed as resolved, at all its
    units. A fault that another one explains is over with that one.
    """
    fault, ends, by = verdict.injection, [], []
    back = [each for each in trial.starts if each.agent == fault.agent and begun <= each.mono <= until and each.report]
    if fault.phm and back:
        _complete_again(verdict, back[0], begun, until)
        return
    if fault.phm and fault.condition == SUSPENDED and verdict.detected_s is not None:
        verdict.claimed_s, verdict.by = verdict.detected_s, OWN_GUARD
        return
    if verdict.missed:
        return
    if verdict.through_cause and verdict.cause is not None:
        cause = verdict.cause
        over = None if cause.claimed_s is None else (cause.injection.moment or begun) + cause.claimed_s - begun
        if over is not None and over >= 0:
            verdict.claimed_s, verdict.by = over, cause.by
        return
    for unit in places(fault):
        found = _end(verdict, trial, unit, begun, until)
        if found is None:
            return
        ends.append(found[0])
        by.append(found[1])
    verdict.claimed_s, verdict.by = max(ends) - begun, ", ".join(dict.fromkeys(by))


def _end(verdict: Verdict, trial: Trial, unit: str, begun: float, until: float) -> tuple[float, str] | None:
    """When the unit was OK again by PHM's record, and by what."""
    agent = verdict.injection.agent
    closes = [
        (alarm.closed, alarm.by)
        for alarm in verdict.alarms
        if (alarm.agent, alarm.unit, alarm.outcome) == (agent, unit, "resolved")
        and alarm.closed is not None
        and begun <= alarm.closed <= until
    ]
    credited = {by for _, by in closes}
    proofs = [
        (act.mono, act.action)
        for act in trial.acts
        if act.phase == "verified" and (act.agent, act.unit) == (agent, unit) and begun <= act.mono <= until
        if not closes or act.action in credited  # verified, but PHM's record names another cause
    ]
    warns = [
        (each.ended, NOTHING)
        for each in trial.warned
        if (each.agent, each.unit) == (agent, unit) and begun <= each.mono <= until
        if each.ended is not None and each.ended <= until
    ]
    return min(proofs or closes or warns, default=None)


def _ended_by(verdict: Verdict, trial: Trial, begun: float) -> str:
    """Which of ENDINGS. An action counts only if the record has it, and nothing else can have ended the fault."""
    fault, by = verdict.injection, verdict.by
    if fault.phm or not fault.unit or by in (OWN_RESTART, OWN_GUARD):
        return PHM
    if fault.passes:
        return INJECTOR
    actions = {act.action for act in trial.acts if act.agent == fault.agent}
    if set(by.split(", ")) <= actions and not _restored_before(verdict, trial, begun):
        return ACTION
    return DOCKER if fault.unit.startswith("container/") else ITSELF


def _restored_before(verdict: Verdict, trial: Trial, begun: float) -> bool:
    """Whether the world was observed broken, and restored before PHM's first action on the agent began."""
    fault = verdict.injection
    started = [
        act.mono for act in trial.acts if act.phase == "started" and act.agent == fault.agent and act.mono >= begun
    ]
    seen = fault.world is not None and fault.world_broken is not None
    return seen and bool(started) and (fault.world or 0.0) < min(started)


def _logged(verdict: Verdict, trial: Trial, begun: float, until: float) -> None:
    """The last step of PHM's response was in its log; the alarm alone where PHM took no step.

    An action that a restart of PHM interrupted is complete when PHM says that its fault is over.
    """
    fault = verdict.injection
    if verdict.detected_s is None:
        return
    steps = {
        act.mono - begun: act.phase
        for act in trial.acts
        if act.phase in STEPS and act.agent == fault.agent and act.unit in places(fault) and begun <= act.mono <= until
    }
    unverified = verdict.ended_by == ACTION and "verified" not in steps.values()
    own = [verdict.claimed_s] if verdict.claimed_s is not None and (fault.phm or unverified) else []
    verdict.logged_s = max([verdict.detected_s, *steps, *own])


def _published(verdict: Verdict, trial: Trial, begun: float) -> None:
    """The next periodic report after the detection, and the first one that lists the fault."""
    fault = verdict.injection
    if verdict.detected_s is None:
        return
    known = begun + verdict.detected_s
    complete = [each for each in trial.summaries if each.agent == fault.agent and each.mono is not None]
    later = [(each.mono or 0.0, each) for each in complete if each.mono is not None and each.mono >= known]
    listed = [mono for mono, each in later if any(unit in each.bad for unit in places(fault))]
    verdict.listed_s = min(listed) - begun if listed else None
    if later:
        verdict.published_s = min(mono for mono, _ in later) - begun
    elif complete:
        period_s = float(trial.setting.get("interval_s", INTERVAL_S))
        verdict.published_s = max(verdict.detected_s, max(each.mono or 0.0 for each in complete) + period_s - begun)
        verdict.published_due = True
