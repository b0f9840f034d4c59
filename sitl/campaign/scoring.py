"""Scores a trial's record for each injected fault. Pure: the rules are those of docs/development/campaign.md."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import dataclass, field

from sitl.campaign.trial import OFF, Alarm, Injection, Line, Start, Trial, Warned

BESIDE = "host/"
"""All agents share one machine: any of them may report its load, which belongs to no injected fault."""
PEERS = "peers/"
"""Every other agent keeps the same unit about an agent that it misses; together they are one alarm."""


@dataclass
class Verdict:
    """One injected fault. Seconds since its injection was complete; None: it did not happen."""

    trial: int
    kind: str
    injection: Injection
    expected: int
    alarms: list[Alarm] = field(default_factory=list)
    detected_s: float | None = None
    response_s: float | None = None
    healed_s: float | None = None
    by: str = ""
    wrong: str = ""
    """Why the reported cause is wrong, in words; empty: it is right, or nothing was reported."""

    @property
    def missed(self) -> bool:
        return self.detected_s is None and not self.alarms

    @property
    def right(self) -> bool:
        return not self.missed and not self.wrong

    @property
    def count(self) -> int:
        """The number of alarms; reports of several agents about the same peer count once."""
        return counted(self.alarms)


@dataclass
class Judged:
    """A trial: its faults, the alarms that belong to none of them, those about the shared machine, and those that
    clearing has caused: a fault that was not recovered is mostly cleared by a restart.
    """

    trial: Trial
    verdicts: list[Verdict]
    false: list[Alarm]
    beside: list[Alarm]
    clearing: list[Alarm]


def judge(trial: Trial) -> Judged:
    """Assign every alarm to its fault, then compute each fault's times."""
    verdicts = [
        Verdict(trial.number, "single" if len(trial.injections) == 1 else "compound", each, due(each))
        for each in trial.injections
        if each.moment is not None
    ]
    false: list[Alarm] = []
    beside: list[Alarm] = []
    clearing: list[Alarm] = []
    for alarm in sorted(trial.alarms, key=lambda each: each.mono):
        owner = _owner(alarm, verdicts)
        if owner is not None:
            cleared = owner.injection.cleared
            (clearing if cleared is not None and alarm.mono > cleared else owner.alarms).append(alarm)
        elif alarm.unit.startswith(BESIDE):
            beside.append(alarm)
        else:
            false.append(alarm)
    for verdict in verdicts:
        _times(verdict, trial)
    return Judged(trial, verdicts, false, beside, clearing)


def counted(alarms: Sequence[Alarm]) -> int:
    """The number of alarms that an operator sees."""
    own = sum(not alarm.unit.startswith(PEERS) for alarm in alarms)
    reported = Counter((alarm.unit, alarm.agent) for alarm in alarms if alarm.unit.startswith(PEERS))
    most: dict[str, int] = {}
    for (unit, _), number in reported.items():
        most[unit] = max(most.get(unit, 0), number)
    return own + sum(most.values())


def _owner(alarm: Alarm, verdicts: Sequence[Verdict]) -> Verdict | None:
    """The fault that an alarm belongs to: at its unit; about its agent as a peer; on its agent, of its group first."""
    begun = [verdict for verdict in verdicts if alarm.mono >= _asked(verdict.injection)]
    for verdict in begun:
        if _expected(alarm, verdict.injection):
            return verdict
    if alarm.unit.startswith(BESIDE):
        return None
    if alarm.unit.startswith(PEERS):
        return next((verdict for verdict in begun if _about(alarm, verdict.injection)), None)
    on_board = [verdict for verdict in begun if verdict.injection.agent == alarm.agent]
    check = alarm.unit.partition("/")[0]
    return next(
        (verdict for verdict in on_board if verdict.injection.group == check), on_board[0] if on_board else None
    )


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


def places(injection: Injection) -> list[str]:
    """Units at which an alarm is expected."""
    return [unit for unit in (injection.unit, *injection.also) if unit]


def due(injection: Injection) -> int:
    """The number of alarms that a fault is expected to raise: none for a warning."""
    units = set(places(injection) if injection.level == "ERROR" else ()) | {injection.others}
    return len(units - {""})


def _expected(alarm: Alarm, injection: Injection) -> bool:
    """Whether the fault is expected to raise this alarm: on its agent, or on the others."""
    if alarm.agent == injection.agent:
        return alarm.unit in places(injection)
    return bool(injection.others) and alarm.unit == injection.others


def _times(verdict: Verdict, trial: Trial) -> None:
    fault = verdict.injection
    begun = fault.moment or 0.0
    until = fault.cleared if fault.cleared is not None else math.inf
    if not fault.unit:
        _rebirth(verdict, trial, begun, until)
        return
    named = [alarm for alarm in verdict.alarms if (alarm.agent, alarm.unit) == (fault.agent, fault.unit)]
    warned = [
        each for each in trial.warned if each.agent == fault.agent and each.unit in places(fault) and each.mono >= begun
    ]
    first: Sequence[Alarm | Warned] = named or [each for each in warned if each.unit == fault.unit]
    verdict.wrong = _wrong(
        verdict, named, {condition for each in warned if each.unit == fault.unit for condition in each.conditions}
    )
    if first:
        verdict.detected_s = max(0.0, first[0].mono - begun)
        reported = [line.mono for line in trial.lines if line.mono >= begun and reports(line, fault, first[0].slot)]
        verdict.response_s = min(reported) - begun if reported else None
    if trial.kind != OFF:
        _healing(verdict, trial, warned, begun, until)


def _rebirth(verdict: Verdict, trial: Trial, begun: float, until: float) -> None:
    """PHM itself was down: its next run reports by its first line, and is complete with its first complete report."""
    fault = verdict.injection
    start = next((each for each in trial.starts if each.agent == fault.agent and each.mono >= begun), None)
    if start is None:
        return
    verdict.detected_s = start.mono - begun
    lines = [line.mono for line in trial.lines if line.system == fault.agent and line.mono >= start.mono]
    verdict.response_s = min(lines) - begun if lines else None
    _rebirth_healed(verdict, start, begun, until)


def _rebirth_healed(verdict: Verdict, start: Start, begun: float, until: float) -> None:
    if start.report is not None and start.report <= until:
        verdict.healed_s, verdict.by = start.report - begun, "its own restart"


def _healing(verdict: Verdict, trial: Trial, warned: Sequence[Warned], begun: float, until: float) -> None:
    """Over before it was cleared: verified by an action, or closed as resolved. This must be true for all of its units."""
    fault, ends, by = verdict.injection, [], []
    back = [each for each in trial.starts if each.agent == fault.agent and each.mono >= begun and each.report]
    if fault.phm and back:
        _rebirth_healed(verdict, back[0], begun, until)
        return
    if fault.phm and verdict.detected_s is not None:
        verdict.healed_s, verdict.by = verdict.detected_s, "its own guard"
        return
    for unit in places(fault):
        proofs = [
            (act.mono, act.action)
            for act in trial.acts
            if act.phase == "verified" and act.unit == unit and act.agent == fault.agent and begun <= act.mono <= until
        ]
        closes = [
            (alarm.closed, alarm.by)
            for alarm in verdict.alarms
            if (alarm.agent, alarm.unit) == (fault.agent, unit)
            and alarm.outcome == "resolved"
            and alarm.closed is not None
            and alarm.closed <= until
        ]
        warns = [
            (each.ended, "itself")
            for each in warned
            if each.unit == unit and each.ended is not None and each.ended <= until
        ]
        found = min(proofs or closes or warns, default=None)
        if found is None:
            return
        ends.append(found[0])
        by.append(found[1])
    verdict.healed_s, verdict.by = max(ends) - begun, ", ".join(dict.fromkeys(by))


def _wrong(verdict: Verdict, named: Sequence[Alarm], warned: Set[str]) -> str:
    """`warned`: conditions with which the unit was WARN."""
    fault = verdict.injection
    if not named and not warned:
        return f"reported at {_units(verdict.alarms)}, expected at {fault.unit}" if verdict.alarms else ""
    known = {condition for alarm in named for condition in alarm.conditions} | warned
    if named:
        earlier = [alarm for alarm in verdict.alarms if alarm.mono < named[0].mono and not _expected(alarm, fault)]
        if earlier:
            return f"reported at {_units(earlier)} first, then at {fault.unit}"
    if fault.condition and fault.condition not in known:
        return f"known as {', '.join(sorted(known)) or 'nothing'}, expected {fault.condition}"
    return ""


def _units(alarms: Sequence[Alarm]) -> str:
    return ", ".join(dict.fromkeys(alarm.unit for alarm in alarms))


def reports(line: Line, fault: Injection, slot: int) -> bool:
    """Whether a line reports a bad state of this agent in that slot: a change, or the refresh; from itself or another
    agent.
    """
    who = f"A{fault.agent:02d}"
    words = "FAIL|GAVE UP|WARN" if fault.level == "WARN" else "FAIL|GAVE UP"
    if re.match(rf"{who} ({words}) (?:[01-]{{8}} )?{slot}\b", line.text):
        return True
    if re.match(rf"{who} no GCS radio", line.text):
        return fault.layer == "link"
    return (
        fault.unit.startswith(PEERS) and re.search(rf" (FAIL|WARN) 12 .*\b({who}|split|alone)\b", line.text) is not None
    )
