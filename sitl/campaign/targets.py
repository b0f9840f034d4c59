"""The reference values of a campaign: the paper's Table 2, and PHM's targets for each profile and load. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate

from sitl.campaign.groups import Group
from sitl.campaign.metrics import Figures
from sitl.campaign.stats import Estimate
from sitl.campaign.trial import BUSY, QUIET
from sitl.campaign.verdict import Verdict

Value = float | int | None


@dataclass(frozen=True)
class Metric:
    """One row of the table. `total`: of all seeds together; otherwise the mean over the seeds. `always`: measured also
    where nothing was injected.
    """

    name: str
    paper: str
    value: Callable[[Figures], Value]
    shown: Callable[[float], str]
    total: bool = False
    always: bool = False


@dataclass(frozen=True)
class Target:
    """`words`: as shown; `met`: tests a value."""

    words: str
    met: Callable[[float], bool]


@dataclass(frozen=True)
class Result:
    """A metric of a group. `met` is None without a target, or when nothing was measured."""

    metric: Metric
    value: Value
    estimate: Estimate | None
    aim: str
    met: bool | None

    @property
    def shown(self) -> str:
        """The value, with the confidence interval of a mean over several seeds."""
        if self.value is None:
            return "not measured"
        text = self.metric.shown(self.value)
        if self.estimate is not None and self.estimate.half is not None:
            text += f" ± {self.metric.shown(self.estimate.half).split(' ')[0]}"
        return text


def seconds(value: float) -> str:
    return f"{value:.2f} s"


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _fine(value: float) -> str:
    return f"{100 * value:.3f} %"


def _whole(value: float) -> str:
    return f"{value:.0f}"


METRICS = (
    Metric("Fault detection, mean", "-", lambda f: f.detection.mean, seconds),
    Metric("Fault detection, p95", "-", lambda f: f.detection.p95, seconds),
    Metric("Earliest possible detection of the same faults, mean", "-", lambda f: f.evidence.mean, seconds),
    Metric("Fault detection as the paper defines it, mean", "5.2 s", lambda f: f.logged.mean, seconds),
    Metric("Response, mean", "-", lambda f: f.response.mean, seconds),
    Metric("Response as the paper defines it, mean", "14.82 s", lambda f: f.published.mean, seconds),
    Metric("Recovery by action, mean", "-", lambda f: f.recovery.mean, seconds),
    Metric("Recovery by action, p95", "-", lambda f: f.recovery.p95, seconds),
    Metric("Self-resolved: by action, of all injected", "16.6 %", lambda f: f.by_action, percent),
    Metric("Self-resolved: largest share that the injected faults allow", "-", lambda f: f.by_action_possible, percent),
    Metric("By action, of the healable", "-", lambda f: f.by_action_healable, percent),
    Metric("PHM uptime", "96.77 %", lambda f: f.uptime, _fine, always=True),
    Metric("Alarms per fault", "chains", lambda f: f.alarms_per_fault, "{:.2f}".format),
    Metric("Cause reported correctly", "-", lambda f: f.right, percent),
    Metric("Missed", "-", lambda f: f.missed, _whole, total=True),
    Metric("False alarms", "-", lambda f: f.false, _whole, total=True, always=True),
    Metric("Actions that did not help", "-", lambda f: f.unhelpful, _whole, total=True),
    Metric("Sidecar, CPU of one core, all runs", "-", lambda f: f.cpu_all, "{:.2f} %".format, always=True),
    Metric("Sidecar, PSS, mean", "-", lambda f: f.pss_mb, "{:.0f} MB".format, always=True),
    Metric("Changed with recovery off", "-", lambda f: f.off_changes, _whole, total=True, always=True),
)


def _recovery_s(verdict: Verdict) -> float | None:
    return verdict.recovered_s if verdict.by_action else None


TIMES: dict[str, tuple[Callable[[Verdict], float | None], float | None]] = {
    "Fault detection, mean": (lambda v: v.detected_s, None),
    "Fault detection, p95": (lambda v: v.detected_s, 0.95),
    "Response, mean": (lambda v: v.response_s, None),
    "Recovery by action, mean": (_recovery_s, None),
    "Recovery by action, p95": (_recovery_s, 0.95),
}
"""What a load may double, with the time of one fault, and the share of a percentile; None: the mean."""


def at_most(limit: float, shown: Callable[[float], str]) -> Target:
    return Target(f"<= {shown(limit)}", lambda value: value <= limit)


def at_least(limit: float, shown: Callable[[float], str]) -> Target:
    return Target(f">= {shown(limit)}", lambda value: value >= limit)


NONE = Target("0", lambda value: value == 0)
ONE = Target("1.00", lambda value: round(value, 2) == 1.0)
ALWAYS = {
    "PHM uptime": at_least(0.999, percent),
    "Cause reported correctly": at_least(0.98, percent),
    "Missed": NONE,
    "False alarms": NONE,
    "Changed with recovery off": NONE,
}
"""For every profile and load."""
ON_QUIET = {
    "Alarms per fault": ONE,
    "By action, of the healable": Target("100 %", lambda value: value >= 1.0),
    "Self-resolved: by action, of all injected": at_least(0.65, percent),
    "Sidecar, CPU of one core, all runs": at_most(2.5, "{:.1f} %".format),
    "Sidecar, PSS, mean": at_most(75.0, "{:.0f} MB".format),
}
SHIPPED = {
    "Fault detection, mean": at_most(1.0, seconds),
    "Fault detection, p95": at_most(3.5, seconds),
    "Response, mean": at_most(1.2, seconds),
    "Recovery by action, mean": at_most(4.5, seconds),
    "Recovery by action, p95": at_most(10.0, seconds),
}
TUNED = {
    **SHIPPED,
    "Fault detection, mean": at_most(0.7, seconds),
    "Fault detection, p95": at_most(3.0, seconds),
    "Response, mean": at_most(1.0, seconds),
}
AS_FOUND = {"Alarms per fault": ONE, "Fault detection, p95": at_most(6.0, seconds)}
ON_BUSY = {"Alarms per fault": at_most(1.05, "{:.2f}".format), "Actions that did not help": NONE}


def targets(group: Group, quiet: Group | None) -> dict[str, Target]:
    """By name of the metric. `quiet`: the same profile on a quiet machine, which limits the times under load."""
    if group.load == BUSY:
        doubled = {} if quiet is None else {name: _doubled(group.all, quiet.all, name) for name in TIMES}
        return {**ALWAYS, **ON_BUSY, **{name: target for name, target in doubled.items() if target is not None}}
    if group.profile == "as-found":
        return {**ALWAYS, **AS_FOUND}
    return {**ALWAYS, **ON_QUIET, **(TUNED if group.profile == "tuned" else SHIPPED)}


def _doubled(busy: Figures, quiet: Figures, name: str) -> Target | None:
    """At most twice the time on a quiet machine, by the classes of faults for which both have one, each with the same weight: the groups
    have different faults, and some are slow for other reasons than the load. None without such a class.
    """
    time_of, share = TIMES[name]
    here, there = _by_class(busy, time_of), _by_class(quiet, time_of)
    both = here.keys() & there.keys()
    if not both:
        return None
    value, limit = (_weighted([found[each] for each in sorted(both)], share) for found in (here, there))
    words = f"<= twice quiet, by class ({len(both)} in both): {seconds(value)} of {seconds(2 * limit)}"
    return Target(words, lambda _: value <= 2 * limit)


def _by_class(found: Figures, time_of: Callable[[Verdict], float | None]) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {}
    for verdict in found.verdicts:
        time_s = time_of(verdict)
        if time_s is not None:
            times.setdefault(verdict.injection.fault, []).append(time_s)
    return times


def _weighted(classes: Sequence[Sequence[float]], share: float | None) -> float:
    """The mean, or the smallest value that is not below this share of all; all classes weigh the same."""
    weighted = sorted((value, 1 / len(each) / len(classes)) for each in classes for value in each)
    if share is None:
        return math.fsum(value * weight for value, weight in weighted)
    reached = accumulate(weight for _, weight in weighted)
    return next(
        (value for (value, _), sum_ in zip(weighted, reached, strict=True) if sum_ >= share - 1e-9), weighted[-1][0]
    )


def slower(groups: Sequence[Group]) -> list[tuple[str, ...]]:
    """For each group under load: how many classes are detected, on average, after more than twice the time of the quiet group."""
    cells = []
    for group in groups:
        quiet = _quiet(group, groups)
        if group.load != BUSY or quiet is None:
            cells.append("-")
            continue
        here, there = (_by_class(each.all, TIMES["Fault detection, mean"][0]) for each in (group, quiet))
        both = sorted(here.keys() & there.keys())
        more = sum(_weighted([here[each]], None) > 2 * _weighted([there[each]], None) for each in both)
        cells.append(f"{more} of {len(both)}")
    return [("Classes detected after more than twice the mean time of the quiet group, of those in both", *cells)]


def _quiet(group: Group, groups: Sequence[Group]) -> Group | None:
    return next((each for each in groups if (each.profile, each.load) == (group.profile, QUIET)), None)


def evaluated(group: Group, others: Sequence[Group] = ()) -> list[Result]:
    """Every metric of the group with its target. `others`: all groups of the record."""
    known = targets(group, _quiet(group, others))
    return [_result(metric, group, known.get(metric.name)) for metric in METRICS]


def _result(metric: Metric, group: Group, target: Target | None) -> Result:
    aim = "" if target is None else target.words
    if not group.trials or not (group.all.injected or metric.always):
        return Result(metric, None, None, aim, None)
    found = None if metric.total else group.mean(metric.value)
    value = metric.value(group.all) if metric.total else found.mean if found is not None else None
    met = None if value is None or target is None else target.met(value)
    return Result(metric, value, found, aim, met)


def short(groups: Sequence[Group]) -> list[str]:
    """The missed targets as text; empty when every measured target is met."""
    return [
        f"{group.name}: {result.metric.name}: {result.shown}, aim {result.aim}"
        for group in groups
        for result in evaluated(group, groups)
        if result.met is False
    ]
