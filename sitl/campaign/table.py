"""The tables of a campaign as text rows, for terminal, Markdown, HTML: one column for each profile and load. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

from sitl.campaign import uptime
from sitl.campaign.groups import Group
from sitl.campaign.metrics import Figures
from sitl.campaign.stats import Stats, stats
from sitl.campaign.targets import evaluated, percent
from sitl.campaign.trial import INTERRUPTION_S, NOMINAL, OFF, TRIAL
from sitl.campaign.verdict import ACTION, ENDINGS, Verdict

Rows = list[tuple[str, ...]]
MET = {True: "met", False: "NOT met"}
Shown = Callable[[Figures], str]


def head(first: str, groups: Sequence[Group], *more: str) -> tuple[str, ...]:
    return (first, *more, *(group.name for group in groups))


def paper_comparison(groups: Sequence[Group]) -> Rows:
    """The paper's parameters, then every metric with its target and whether it is met."""

    def settings(key: str, unit: str = "") -> list[str]:
        return [" / ".join(f"{value}{unit}" for value in group.settings(key)) or "-" for group in groups]

    rows: Rows = [
        ("Parameter: Reactivation Interval", "20 s", *settings("interval_s", " s")),
        ("Parameter: SITL Agents", "8", *(str(group.all.agents) for group in groups)),
        ("Parameter: seeds", "not stated", *(str(len(group.seeds)) for group in groups)),
        ("Parameter: trials", "20", *(str(group.all.trials) for group in groups)),
        ("Parameter: faults injected", "not stated", *(str(group.all.injected) for group in groups)),
    ]
    columns = [evaluated(group, groups) for group in groups]
    for results in zip(*columns, strict=True):
        metric = results[0].metric
        cells = [
            each.shown + (f"; aim {each.aim}: {MET[each.met]}" if each.met is not None else "") for each in results
        ]
        rows.append((metric.name, metric.paper, *cells))
    return rows


def spreads(groups: Sequence[Group]) -> Rows:
    """Standard deviation, smallest and largest value of each mean over the seeds."""
    rows: Rows = []
    for results in zip(*(evaluated(group, groups) for group in groups), strict=True):
        if results[0].metric.total:
            continue
        cells = []
        for each in results:
            shown, found = each.metric.shown, each.estimate
            if found is None or found.deviation is None or found.least is None or found.most is None:
                cells.append("-")
            else:
                cells.append(f"{shown(found.deviation)}; {shown(found.least)} to {shown(found.most)}")
        rows.append((results[0].metric.name, *cells))
    return rows


def endings(groups: Sequence[Group]) -> Rows:
    """What has ended the faults, as number and share of all injected faults."""

    def of(number: Callable[[Figures], int]) -> Shown:
        return lambda f: f"{number(f)} ({percent(number(f) / f.injected)})" if f.injected else "-"

    def ended_by(ending: str) -> Shown:
        return of(lambda f: f.endings[ending])

    wanted: list[tuple[str, Shown]] = [
        ("action of PHM, confirmed from outside: self-resolved", of(lambda f: f.endings[ACTION] - f.unconfirmed)),
        ("action of PHM, not confirmed from outside", of(lambda f: f.unconfirmed)),
        ("of these, the world was never seen broken", of(lambda f: f.never_broken)),
        *((ending, ended_by(ending)) for ending in ENDINGS if ending != ACTION),
        ("cleared by the campaign", of(lambda f: f.injected - sum(f.endings.values()))),
        ("injected", lambda f: str(f.injected)),
        ("could not be injected, in no row above", lambda f: str(f.not_injected)),
    ]
    return _rows(wanted, groups)


def definitions(groups: Sequence[Group]) -> Rows:
    """Detection and response by both definitions."""
    wanted: list[tuple[str, Shown]] = [
        ("detection: the alarm is in the log", lambda f: spread(f.detection, f.injected)),
        ("detection, paper: PHM's response is complete and in the log", lambda f: spread(f.logged, f.injected)),
        ("response: first STATUSTEXT at the ground", lambda f: spread(f.response, f.injected)),
        ("response, paper: the next periodic report", lambda f: spread(f.published, f.injected)),
        ("a periodic report lists the fault before its end", lambda f: spread(f.listed, f.injected)),
    ]
    return _rows(wanted, groups)


def outside(groups: Sequence[Group]) -> Rows:
    """PHM's claims beside the injector's own observation of the world."""

    def count(wanted: Callable[[Verdict], bool]) -> Shown:
        return lambda f: str(sum(wanted(verdict) for verdict in f.verdicts))

    def claims(verdict: Verdict) -> bool:
        return verdict.claimed_s is not None

    def lasts(verdict: Verdict) -> bool:
        return verdict.observed and not claims(verdict) and verdict.world_s is None

    def interruptions(found: Figures) -> str:
        counts = [v.injection.interruptions for v in found.verdicts if v.injection.interruptions is not None]
        seconds = sum(v.injection.interrupted_s for v in found.verdicts)
        return f"{sum(map(bool, counts))}, {sum(counts)}, {seconds:.1f}" if counts else "not measured"

    wanted: list[tuple[str, Shown]] = [
        ("both say that the fault is over", count(lambda v: v.difference_s is not None)),
        ("both say that it is not over: healable", count(lambda v: lasts(v) and v.injection.healable)),
        (
            "both say that it is not over: not healable; mostly the injector's own setting",
            count(lambda v: lasts(v) and not v.injection.healable),
        ),
        ("disagreement: PHM says that it is over, the world does not", count(lambda v: v.claimed_wrongly)),
        ("disagreement: the world is restored, PHM does not say so", count(lambda v: v.unnoticed)),
        ("PHM said so more than 1 s before the world was seen restored", count(lambda v: v.claimed_early)),
        ("the world was never seen broken", count(lambda v: v.observed and v.injection.world_broken is None)),
        (
            f"a restored world that was seen broken for less than {INTERRUPTION_S:g} s: faults, times, seconds",
            interruptions,
        ),
        ("PHM says that it is over; cannot be observed", count(lambda v: claims(v) and not v.observed)),
        ("not over; cannot be observed", count(lambda v: not claims(v) and not v.observed)),
        ("seconds from the world to PHM's claim", lambda f: differences(stats(v.difference_s for v in f.verdicts))),
    ]
    return _rows(wanted, groups)


def left_out(groups: Sequence[Group]) -> Rows:
    """Everything that is in no mean, or not counted."""

    def blind(found: Figures) -> str:
        watched = [each.trial for each in found.judged if each.trial.kind != OFF]
        agents = [(trial, agent) for trial in watched for agent in range(1, trial.agents + 1)]
        spared = sum(
            uptime.of_agent(trial, agent, net=False)[0] - uptime.of_agent(trial, agent)[0] for trial, agent in agents
        )
        return f"{spared:.0f} s of {sum(trial.seconds for trial, _ in agents):.0f} s"

    def lacks(value: Callable[[Verdict], float | None]) -> Shown:
        return lambda f: str(sum(value(verdict) is None for verdict in f.verdicts))

    wanted: list[tuple[str, Shown]] = [
        ("injection failed: in no figure", lambda f: str(f.not_injected)),
        ("all times: faults of the runs with recovery off", lambda f: str(_without_recovery(f))),
        ("detection: missed", lambda f: str(sum(verdict.missed for verdict in f.verdicts))),
        ("detection: reported by the alarm of another fault of the agent", lambda f: str(f.through_cause)),
        ("detection: reported at another unit only", lambda f: str(_elsewhere(f))),
        ("response: no STATUSTEXT received", lacks(lambda v: v.response_s)),
        ("response, paper: no periodic report", lacks(lambda v: v.published_s)),
        ("response, paper: in the mean as when it was due, after the trial", lambda f: str(f.published_due)),
        ("recovery: ended otherwise or not confirmed; PHM's claims", lambda f: spread(f.recovery_other, f.injected)),
        ("false alarms: `host/*`, confirmed by the measured load", lambda f: str(len(f.beside))),
        (
            "false alarms: an application without a fault, observed not to work for 5 s",
            lambda f: str(len(f.app_broken)),
        ),
        ("alarms and warnings: caused by clearing", lambda f: str(len(f.clearing))),
        ("alarms: before the fault, by its injection", lambda f: str(f.before)),
        ("actions: interrupted by the end of the trial", lambda f: str(f.unfinished)),
        ("cost: agents of runs without measurement", lambda f: str(f.without_cost)),
        ("uptime: agent cut from the ground by the campaign", blind),
        ("all events: pauses between the runs of a seed, which are not recorded", _pauses),
        ("uptime: run with recovery off", lambda f: f"{sum(each.trial.kind == OFF for each in f.judged)} runs"),
    ]
    return _rows(wanted, groups)


def _pauses(found: Figures) -> str:
    """How long the swarm ran between runs, beside the time of the runs."""
    runs = sorted((each.trial for each in found.judged), key=lambda trial: trial.began)
    pairs = [(one, two) for one, two in pairwise(runs) if one.setting.get("seed") == two.setting.get("seed")]
    paused_s = sum(max(0.0, two.began - one.ended) for one, two in pairs)
    return f"{paused_s / 60:.0f} min beside {sum(trial.seconds for trial in runs) / 60:.0f} min"


def _without_recovery(found: Figures) -> int:
    return sum(len(each.verdicts) for each in found.judged if each.trial.kind == OFF)


def _elsewhere(found: Figures) -> int:
    return sum(v.detected_s is None and not v.missed and not v.through_cause for v in found.verdicts)


def beyond(groups: Sequence[Group]) -> Rows:
    """Figures without a target."""

    def in_use(found: Figures) -> str:
        return " / ".join(number(machine_cpu(found, kind), "{:.0f} %") for kind in (NOMINAL, TRIAL))

    def nominal(found: Figures) -> str:
        beside = sum(len(each.beside) for each in found.judged if each.trial.kind == NOMINAL)
        return f"{found.nominal_s:.0f} s, {found.nominal_alarms} false alarms, {beside} about `host/*` confirmed by the load"

    wanted: list[tuple[str, Shown]] = [
        ("Recovery by action, mean / p50 / p95 / max", lambda f: spread(f.recovery, f.injected)),
        ("Machine, CPU in use: nothing injected / all trials", in_use),
        ("Faults with fewer alarms than expected", lambda f: str(f.lacking)),
        ("Nothing injected", nominal),
        ("Starts of PHM during runs, injected or not", lambda f: str(f.restarts)),
        ("PHM received at the ground, cut radios counted as silence", lambda f: _share(f.received)),
        ("Bytes per agent and second, nothing injected", lambda f: number(f.bytes_nominal, "{:.1f}")),
        ("Bytes per agent and second, all runs", lambda f: number(f.bytes_all, "{:.1f}")),
        ("Sidecar, CPU of one core, nothing injected", lambda f: number(f.cpu_nominal, "{:.2f} %")),
        ("Sidecar, RSS, mean", lambda f: number(f.rss_mb, "{:.0f} MB")),
        ("Sidecar, largest resident memory", lambda f: number(f.peak_mb, "{:.0f} MB")),
    ]
    return _rows(wanted, groups)


def _rows(wanted: Sequence[tuple[str, Shown]], groups: Sequence[Group]) -> Rows:
    return [(name, *(shown(group.all) for group in groups)) for name, shown in wanted]


def machine_cpu(found: Figures, kind: str) -> float | None:
    """Mean over the runs of this kind, in percent of all cores."""
    return stats(each.trial.machine_cpu for each in found.judged if each.trial.kind == kind).mean


def _share(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.3f} %"


def spread(found: Stats, of: int) -> str:
    if not found.n:
        return "-"
    numbers = " / ".join(number(value) for value in (found.mean, found.p50, found.p95, found.max))
    return f"{numbers} s, {found.n} of {of}"


def differences(found: Stats) -> str:
    if not found.n:
        return "-"
    return f"mean {number(found.mean)}, {number(found.min)} to {number(found.max)}"


def number(value: float | None, form: str = "{:.2f}") -> str:
    return "-" if value is None else form.format(value)
