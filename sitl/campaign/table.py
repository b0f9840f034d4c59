"""A campaign's figures as text rows, for terminal, Markdown, HTML. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.campaign.metrics import Figures, Stats
from sitl.campaign.scoring import Judged, Verdict
from sitl.campaign.targets import judged

TABLE2 = ("metric", "paper, Table 2", "here", "aim", "")
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
    "healed: mean",
    "p95",
    "self-resolved",
    "missed",
    "wrong cause",
    "alarms per fault",
)
TRIALS = ("trial", "agent", "fault", "detected", "reported", "healed", "by", "alarms", "remarks")
MET = {True: "met", False: "NOT met", None: ""}


def table2(found: Figures, interval_s: float) -> list[tuple[str, ...]]:
    """The paper's parameters, then every metric with its target and whether it is met."""
    rows: list[tuple[str, ...]] = [
        ("Parameter: Reactivation Interval", "20 s", f"{interval_s:g} s", "", ""),
        ("Parameter: SITL Agents", "8", str(found.agents), "", ""),
        ("Parameter: trials, faults injected", "20, not stated", f"{found.trials}, {found.injected}", "", ""),
    ]
    return rows + [(row.name, row.paper, row.shown, row.aim, MET[row.met]) for row in judged(found)]


def beyond(found: Figures) -> list[tuple[str, str]]:
    """Figures without a target."""
    heard = "-" if found.heard is None else f"{100 * found.heard:.3f} %"
    return [
        ("Healing time, mean / p50 / p95 / max", spread(found.healing)),
        ("Detection, mean / p50 / p95 / max", spread(found.detection)),
        ("Response, mean / p50 / p95 / max", spread(found.response)),
        ("Nothing injected", f"{found.nominal_s:.0f} s, {found.nominal_alarms} alarms"),
        ("Could not be injected", str(found.not_injected)),
        ("Alarms about the machine that all agents share", str(len(found.beside))),
        ("Alarms that clearing has caused", str(len(found.clearing))),
        ("PHM heard at the ground, cut radios counted as silence", heard),
        ("Bytes per agent and second at the ground, nothing injected", number(found.bytes_nominal, "{:.1f}")),
        ("Bytes per agent and second at the ground, all trials", number(found.bytes_all, "{:.1f}")),
        ("Sidecar, CPU of one core, all trials", number(found.cpu_all, "{:.2f} %")),
        ("Sidecar, RSS of the largest", number(found.rss_mb, "{:.0f} MB")),
    ]


def classes(found: Figures) -> list[tuple[str, ...]]:
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
            number(each.healing.mean),
            number(each.healing.p95),
            f"{each.resolved} of {each.injected}" + ("" if each.healable else " (not healable)"),
            str(each.missed),
            str(each.wrong),
            number(each.alarms),
        )
        for each in sorted(found.classes, key=lambda one: (one.layer, one.title))
    ]


def trials(judged_trials: Sequence[Judged]) -> list[tuple[str, ...]]:
    """One row for each injected fault, with remarks."""
    return [_trial(each, verdict) for each in judged_trials for verdict in each.verdicts]


def _trial(each: Judged, verdict: Verdict) -> tuple[str, ...]:
    fault = verdict.injection
    name = f"{each.trial.number}" if each.trial.kind == "trial" else each.trial.kind
    times = (number(value) for value in (verdict.detected_s, verdict.response_s, verdict.healed_s))
    return (
        name,
        f"A{fault.agent:02d}",
        fault.title,
        *times,
        verdict.by,
        str(verdict.count),
        "; ".join(remarks(each, verdict)),
    )


def remarks(each: Judged, verdict: Verdict) -> list[str]:
    """The problems of this fault."""
    fault, found = verdict.injection, []
    if verdict.missed and fault.unit:
        found.append("missed")
    if verdict.missed and not fault.unit:
        found.append("PHM did not come back by itself")
    if verdict.wrong:
        found.append(verdict.wrong)
    if verdict.count > verdict.expected:
        extra = [alarm.unit for alarm in verdict.alarms if alarm.unit not in (fault.unit, *fault.also)]
        found.append(f"{verdict.count} alarms for {verdict.expected}: {', '.join(extra) or 'reported again'}")
    if each.trial.kind == "trial" and verdict.healed_s is None and fault.healable:
        found.append("not healed")
    if each.trial.well_after is None:
        found.append("not all well afterwards")
    return found


def short(judged_trials: Sequence[Judged]) -> list[str]:
    """All problems, one sentence each."""
    lines = [
        f"trial {each.trial.number}, {verdict.injection.fault} on A{verdict.injection.agent:02d}: {remark}"
        for each in judged_trials
        if each.trial.kind == "trial"
        for verdict in each.verdicts
        for remark in remarks(each, verdict)
    ]
    lines += [
        f"{each.trial.kind} {each.trial.number}: false alarm on board A{alarm.agent:02d} at {alarm.unit}: {alarm.summary}"
        for each in judged_trials
        for alarm in each.false
    ]
    lines += [
        f"trial {each.trial.number}: {fault.fault} on A{fault.agent:02d} could not be injected: {fault.error}"
        for each in judged_trials
        for fault in each.trial.injections
        if fault.moment is None
    ]
    return lines + [f"recovery off: {change}" for each in judged_trials for change in each.trial.changed]


def spread(found: Stats) -> str:
    if not found.n:
        return "-"
    return (
        " / ".join(number(value) for value in (found.mean, found.p50, found.p95, found.max)) + f" s, {found.n} of them"
    )


def number(value: float | None, form: str = "{:.2f}") -> str:
    return "-" if value is None else form.format(value)
