"""Scores a trial's record for each injected fault. Pure: the rules are those of docs/development/campaign.md."""

from __future__ import annotations

from collections.abc import Sequence, Set

from sitl.campaign import application_alarms
from sitl.campaign.disturbance import disturbed
from sitl.campaign.fault_catalog import EXPLAINS
from sitl.campaign.host_load import confirmed
from sitl.campaign.times import measure
from sitl.campaign.trial import Alarm, Injection, RaisedWarning, Trial
from sitl.campaign.verdict import BESIDE, PEERS, ScoredTrial, Verdict, due, expects, until

ABOUT_TOPICS = frozenset({"consensus", "data", "rates"})
"""Checks whose alarms are about topics, too."""


def judge(trial: Trial) -> ScoredTrial:
    """Assign every alarm to its fault, then compute each fault's times."""
    verdicts = [
        Verdict(trial.number, "single" if len(trial.injections) == 1 else "compound", each, due(each))
        for each in trial.injections
        if each.moment is not None
    ]
    for verdict in verdicts:
        verdict.cause = _cause(verdict.injection, verdicts)
    false: list[Alarm] = []
    beside: list[Alarm] = []
    app_broken: list[Alarm] = []
    clearing: list[Alarm | RaisedWarning] = []
    for alarm in sorted(trial.alarms, key=lambda each: each.mono):
        owner = _owner(alarm, verdicts)
        if owner is not None and alarm.mono <= until(owner.injection):
            owner.alarms.append(alarm)
        elif owner is not None:
            (clearing if _by_clearing(alarm, owner.injection, verdicts) else owner.after).append(alarm)
        elif alarm.unit.startswith(BESIDE) and confirmed(alarm, trial.machine):
            beside.append(alarm)
        elif application_alarms.confirmed(alarm, trial.broken):
            app_broken.append(alarm)
        else:
            false.append(alarm)
    for verdict in sorted(verdicts, key=lambda each: each.cause is not None):
        warned = _warned(verdict, trial)
        clearing += [each for each in warned if each.mono > until(verdict.injection)]
        warned = [each for each in warned if each not in clearing]
        named = _named(verdict)
        verdict.wrong = _wrong(verdict, named, {condition for each in warned for condition in each.conditions})
        measure(verdict, trial, sorted([*named, *warned], key=lambda each: each.mono))
        verdict.disturbed = disturbed(verdict, trial)
    return ScoredTrial(trial, verdicts, false, beside, app_broken, clearing)


def _cause(fault: Injection, verdicts: Sequence[Verdict]) -> Verdict | None:
    """The fault of the same agent that explains this one."""
    return next(
        (
            each
            for each in verdicts
            if fault.explained_by and (each.injection.fault, each.injection.agent) == (fault.explained_by, fault.agent)
        ),
        None,
    )


def _named(verdict: Verdict) -> list[Alarm]:
    """Alarms at the fault's own unit since its injection."""
    fault = verdict.injection
    return [alarm for alarm in verdict.since if (alarm.agent, alarm.unit) == (fault.agent, fault.unit)]


def _warned(verdict: Verdict, trial: Trial) -> list[RaisedWarning]:
    """Warnings at the fault's own unit since its injection, where they report it: an ERROR is not a warning."""
    fault = verdict.injection
    if fault.level != "WARN":
        return []
    begun = fault.moment or 0.0
    return [
        each for each in trial.warned if (each.agent, each.unit) == (fault.agent, fault.unit) and each.mono >= begun
    ]


def _owner(alarm: Alarm, verdicts: Sequence[Verdict]) -> Verdict | None:
    """The fault that an alarm belongs to: at its unit; about its agent as a peer; on its agent, of its group first, then one that
    causes such alarms, then the first one injected.
    """
    begun = [verdict for verdict in verdicts if alarm.mono >= _asked(verdict.injection)]
    for verdict in begun:
        if expects(verdict.injection, alarm):
            return verdict
    if alarm.unit.startswith(BESIDE):
        return None
    if alarm.unit.startswith(PEERS):
        return next((verdict for verdict in begun if _about(alarm, verdict.injection)), None)
    on_board = [verdict for verdict in begun if verdict.injection.agent == alarm.agent]
    check = alarm.unit.partition("/")[0]
    kind = "topics" if check in ABOUT_TOPICS else check
    return min(on_board, key=lambda each: _far(each.injection.group, kind), default=None)


def _far(group: str, kind: str) -> int:
    """How likely a fault of this group causes an alarm of this kind: 0 is the most likely."""
    if group == kind:
        return 0
    causes = group == "container" or kind in EXPLAINS.get(group, ()) or (group, kind) == ("nodes", "topics")
    return 1 if causes else 2


def _by_clearing(alarm: Alarm, fault: Injection, verdicts: Sequence[Verdict]) -> bool:
    """Whether clearing caused it: a container was recreated or started, or the fault was not over and the alarm is at its own unit,
    which sees how it is ended.
    """
    renewed = any(each.injection.renewed for each in verdicts if each.injection.agent in (alarm.agent, fault.agent))
    return renewed or (fault.world is None and expects(fault, alarm))


def _asked(fault: Injection) -> float:
    """The time from which its alarm may be raised: a side effect of the injection, e.g. a restart, comes before the
    fault.
    """
    times = [each for each in (fault.asked, fault.moment) if each is not None]
    return min(times, default=0.0)


def _about(alarm: Alarm, fault: Injection) -> bool:
    """Whether an alarm about peers is a consequence of the fault: it names its agent, is raised on it, or reports a
    split.
    """
    subject = alarm.unit.removeprefix(PEERS)
    concerned = fault.layer == "link" or fault.phm
    return concerned and (subject == f"A{fault.agent:02d}" or alarm.agent == fault.agent or subject == "swarm")


def _wrong(verdict: Verdict, named: Sequence[Alarm], warned: Set[str]) -> str:
    """`warned`: conditions with which the unit was WARN."""
    fault = verdict.injection
    if not fault.unit:
        return ""
    if not named and not warned:
        return f"reported at {_units(verdict.since)}, expected at {fault.unit}" if verdict.since else ""
    known = {condition for alarm in named for condition in alarm.conditions} | warned
    if named:
        earlier = [alarm for alarm in verdict.alarms if alarm.mono < named[0].mono and not expects(fault, alarm)]
        if earlier:
            return f"reported at {_units(earlier)} first, then at {fault.unit}"
    if fault.condition and not known & ({fault.condition, fault.earlier} - {""}):
        return f"known as {', '.join(sorted(known)) or 'nothing'}, expected {fault.condition}"
    return ""


def _units(alarms: Sequence[Alarm]) -> str:
    return ", ".join(dict.fromkeys(alarm.unit for alarm in alarms))
