"""The reference values of a campaign: the paper's Table 2, and PHM's targets for each profile and load. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sitl.campaign.groups import Group
from sitl.campaign.metrics import Figures
from sitl.campaign.stats import Estimate
from sitl.campaign.trial import BUSY, QUIET

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
TIMES = (
    "Fault detection, mean",
    "Fault detection, p95",
    "Response, mean",
    "Recovery by action, mean",
    "Recovery by action, p95",
)


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
        means = {} if quiet is None else {name: quiet.mean(metric.value) for name, metric in _TIMES.items()}
        doubled = {name: at_most(2 * mean.mean, seconds) for name, mean in means.items() if mean is not None}
        return {**ALWAYS, **ON_BUSY, **doubled}
    if group.profile == "as-found":
        return {**ALWAYS, **AS_FOUND}
    return {**ALWAYS, **ON_QUIET, **(TUNED if group.profile == "tuned" else SHIPPED)}


_TIMES = {metric.name: metric for metric in METRICS if metric.name in TIMES}


def evaluated(group: Group, others: Sequence[Group] = ()) -> list[Result]:
    """Every metric of the group with its target. `others`: all groups of the record."""
    quiet = next((each for each in others if (each.profile, each.load) == (group.profile, QUIET)), None)
    known = targets(group, quiet)
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
