"""The tables of a campaign about classes and single faults, as text rows. Pure."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from sitl.campaign.evidence import RATIO, UNEXPLAINED, compared
from sitl.campaign.groups import Group
from sitl.campaign.metrics import Figures
from sitl.campaign.table import Rows, number
from sitl.campaign.verdict import FLOOR_S, ScoredTrial, Verdict, counted

CLASSES = (
    "fault",
    "layer",
    "injected",
    "detected: mean",
    "p50",
    "p95",
    "max",
    "reported at the ground: mean",
    "p95",
    "recovered by action: mean",
    "p95",
    "by action",
    "missed",
    "wrong cause",
    "alarms per fault",
)
FAULTS = (
    "seed",
    "trial",
    "agent",
    "fault",
    "detected",
    "paper",
    "reported",
    "paper",
    "PHM's claim",
    "world",
    "ended by",
    "alarms",
    "remarks",
)
EVIDENCE = ("fault", "earliest evidence", "at the latest after", "on average", "detected", "ratio", "explanation")
DIFFERENCES = ("profile and load", "of", "key", "shipped", "here")
_SIDES = ("shipped", "here")
VALUES = 3
"""Shown of a key that differs between the trials of a fault."""
LEAST = 3
"""Injections of each class."""


def classes(found: Figures) -> Rows:
    """One row for each injected class, in seconds."""
    return [
        (
            each.title,
            each.layer,
            str(each.injected),
            *(
                number(value)
                for value in (each.detection.mean, each.detection.p50, each.detection.p95, each.detection.max)
            ),
            number(each.response.mean),
            number(each.response.p95),
            number(each.recovery.mean),
            number(each.recovery.p95),
            f"{each.by_action} of {each.injected}" + ("" if each.healable else " (not healable)"),
            str(each.missed),
            str(each.wrong),
            number(each.alarms),
        )
        for each in sorted(found.classes, key=lambda one: (one.layer, one.title))
    ]


def classes_by_group(groups: Sequence[Group]) -> Rows:
    """For each class and group: injections, mean detection, and how many an action has ended."""
    titles = sorted({(each.layer, each.title) for group in groups for each in group.all.classes})
    rows: Rows = []
    for layer, title in titles:
        cells = []
        for group in groups:
            each = next((one for one in group.all.classes if one.title == title), None)
            cells.append(
                "-" if each is None else f"{each.injected}: {number(each.detection.mean)} s, {each.by_action} by action"
            )
        rows.append((title, layer, *cells))
    return rows


def rare(groups: Sequence[Group]) -> list[str]:
    """Classes that were injected fewer than LEAST times, as text."""
    return [
        f"{group.name}: {each.title}: {each.injected}"
        for group in groups
        for each in group.all.classes
        if each.injected < LEAST
    ]


def excluded(groups: Sequence[Group]) -> list[str]:
    """Faults that were not to be injected, with the reason."""
    return [f"{group.name}: {name}: {why}" for group in groups for name, why in sorted(group.excluded.items())]


def evidence(found: Figures) -> Rows:
    """Each class beside its limit, the largest ratio first."""
    return [
        (
            each.title,
            each.evidence or "not stated",
            "-" if each.latest_s is None else f"{each.latest_s:g} s",
            "-" if each.limit_s is None else f"{each.limit_s:g} s",
            "-" if each.detection_s is None else f"{each.detection_s:.2f} s",
            number(each.ratio, "{:.1f}"),
            each.words,
        )
        for each in compared(found)
    ]


def unexplained(group: Group) -> list[str]:
    """Classes that are detected late without an explanation, as text."""
    return [
        f"{group.name}: {each.title} is detected after {each.ratio:.1f} times its limit (at least {FLOOR_S:g} s), "
        f"aim {RATIO:g}: {UNEXPLAINED}"
        for each in compared(group.all)
        if each.words == UNEXPLAINED
    ]


def differences(groups: Sequence[Group]) -> Rows:
    """Computed differences from what is shipped, then those of the trials of single faults."""
    rows: Rows = []
    for group in groups:
        rows += [
            (group.name, str(each.get("of", "")), str(each.get("key", "")), *(_value(each, key) for key in _SIDES))
            for each in group.differences
        ]
        rows += _of_trials(group)
    return rows


def _of_trials(group: Group) -> Rows:
    """One row for each fault and key, for any agent N, with all values that it had."""
    found: dict[tuple[str, ...], list[str]] = {}
    for trial in group.trials:
        for each in trial.differences:
            agent = re.compile(rf"(?<=agent_){each['agent']}\b|(?<=-){each['agent']}(?=-)")
            of = f"{each['of']}, for {each['fault']}"
            key, shipped, here = (
                agent.sub("N", text) for text in (each["key"], *(_value(each, key) for key in _SIDES))
            )
            values = found.setdefault((of, key, shipped), [])
            if here not in values:
                values.append(here)
    return [
        (group.name, *row, ", ".join(values[:VALUES]) + (f" and {len(values) - VALUES} more" * (len(values) > VALUES)))
        for row, values in sorted(found.items())
    ]


def _value(difference: dict[str, object], key: str) -> str:
    value = difference.get(key)
    return "absent" if value is None else str(value)


def trials(judged_trials: Sequence[ScoredTrial]) -> Rows:
    """One row for each injected fault, with remarks; for the terminal."""
    return [
        (
            _run(each),
            f"A{verdict.injection.agent:02d}",
            verdict.injection.title,
            number(verdict.detected_s),
            number(verdict.response_s),
            _recovered(verdict),
            verdict.by,
            str(verdict.count),
            "; ".join(remarks(each, verdict)),
        )
        for each in judged_trials
        for verdict in each.verdicts
    ]


def _recovered(verdict: Verdict) -> str:
    """The confirmed time, or PHM's claim and that nothing confirms it."""
    if verdict.recovered_s is None and verdict.claimed_s is not None:
        return f"{number(verdict.claimed_s)} (not confirmed)"
    return number(verdict.recovered_s)


def faults(group: Group) -> Rows:
    """One row for each injected fault of a group, with both definitions, PHM's claim and the world."""
    return [
        (
            str(each.trial.setting.get("index", 0) + 1),
            _run(each),
            f"A{verdict.injection.agent:02d}",
            verdict.injection.title,
            *map(number, (verdict.detected_s, verdict.logged_s, verdict.response_s, verdict.published_s)),
            number(verdict.claimed_s),
            number(verdict.world_s) if verdict.observed else "not observed",
            f"{verdict.ended_by} ({verdict.by})" if verdict.ended_by else "",
            str(verdict.count),
            "; ".join(remarks(each, verdict)),
        )
        for each in group.all.judged
        for verdict in each.verdicts
    ]


def _run(each: ScoredTrial) -> str:
    return f"{each.trial.number}" if each.trial.kind == "trial" else each.trial.kind


def remarks(each: ScoredTrial, verdict: Verdict) -> list[str]:
    """The problems of this fault."""
    fault, found = verdict.injection, []
    if verdict.missed:
        found.append("missed" if fault.unit else "PHM did not come back by itself")
    if verdict.wrong:
        found.append(verdict.wrong)
    if verdict.before:
        found.append(f"before the fault: {', '.join(dict.fromkeys(alarm.unit for alarm in verdict.before))}")
    found += [f"no alarm at {unit}" for unit in verdict.lacking if not verdict.wrong or unit != fault.unit]
    if verdict.after:
        units = ", ".join(dict.fromkeys(alarm.unit for alarm in verdict.after))
        found.append(f"alarms after it was cleared, which clearing has not caused: {units}")
    if counted(verdict.alarms) > verdict.expected:
        extra = [alarm.unit for alarm in verdict.alarms if alarm.unit not in (fault.unit, *fault.also)]
        found.append(
            f"alarms: {counted(verdict.alarms)}, expected {verdict.expected}: {', '.join(extra) or 'reported again'}"
        )
    if each.trial.kind == "trial":
        found += _recovery_remarks(verdict)
    if each.trial.healthy_after is None:
        found.append("not everything was OK afterwards")
    return found


def _recovery_remarks(verdict: Verdict) -> list[str]:
    found = []
    if verdict.claimed_s is None and verdict.injection.healable:
        found.append("not recovered")
    if verdict.claimed_wrongly:
        found.append("PHM says that it is over, the world does not")
    if verdict.unnoticed:
        found.append("the world is restored, PHM does not say so")
    if verdict.claimed_early and verdict.difference_s is not None:
        found.append(f"PHM said {-verdict.difference_s:.1f} s too early that it is over")
    return found


def short(group: Group) -> list[str]:
    """All problems, one sentence each."""
    judged = group.all.judged
    lines = [
        f"{_where(each)}, {verdict.injection.fault} on A{verdict.injection.agent:02d}: {remark}"
        for each in judged
        if each.trial.kind == "trial"
        for verdict in each.verdicts
        for remark in remarks(each, verdict)
    ]
    lines += [
        f"{_where(each)}: false alarm on board A{alarm.agent:02d} at {alarm.unit}: {alarm.summary}"
        for each in judged
        for alarm in each.false
    ]
    lines += [
        f"{_where(each)}: {fault.fault} on A{fault.agent:02d} could not be injected: {fault.error}"
        for each in judged
        for fault in each.trial.injections
        if fault.moment is None
    ]
    helped = Counter(f"{each.action} at {each.unit}" for each in group.all.attempts if each.helped is False)
    lines += [f"did not help: {what}" + (f", {n} times" if n > 1 else "") for what, n in sorted(helped.items())]
    lines += [f"recovery off: {change}" for each in judged for change in each.trial.changed]
    return [f"{group.name}: {line}" for line in lines]


def _where(each: ScoredTrial) -> str:
    seed = f"seed {each.trial.setting.get('index', 0) + 1}, "
    return f"{seed}{each.trial.kind} {each.trial.number}"
