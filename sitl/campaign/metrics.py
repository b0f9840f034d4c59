"""All figures of a campaign, computed from its trials alone. Each is defined in docs/development/campaign.md. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from sitl.campaign import uptime
from sitl.campaign.scoring import Judged, Verdict, judge
from sitl.campaign.trial import NOMINAL, OFF, TRIAL, Alarm, Cost, Trial


@dataclass(frozen=True)
class Stats:
    """Statistics of n values; all None for n = 0. p50 and p95 are by nearest rank, so they are measured values."""

    n: int
    mean: float | None = None
    p50: float | None = None
    p95: float | None = None
    max: float | None = None


def stats(values: Iterable[float | None]) -> Stats:
    """Statistics of the values that are not None."""
    known = sorted(value for value in values if value is not None)
    if not known:
        return Stats(0)
    return Stats(len(known), math.fsum(known) / len(known), rank(known, 0.5), rank(known, 0.95), known[-1])


def rank(ordered: Sequence[float], part: float) -> float:
    """The smallest of the ordered values that is not below the share `part` (0 to 1) of them."""
    return ordered[max(0, math.ceil(part * len(ordered)) - 1)]


@dataclass(frozen=True)
class OfClass:
    """All injections of one class of fault. Shares are from 0 to 1."""

    fault: str
    title: str
    layer: str
    healable: bool
    injected: int
    detection: Stats
    response: Stats
    healing: Stats
    resolved: int
    missed: int
    wrong: int
    alarms: float | None
    """Per alarm that was due, of what was reported at all; None where none was due."""


@dataclass(frozen=True)
class Figures:
    """A campaign. Times in seconds, shares from 0 to 1, CPU in percent of one core."""

    agents: int
    trials: int
    injected: int
    not_injected: int
    detection: Stats
    response: Stats
    healing: Stats
    resolved_healable: float | None
    resolved: float | None
    uptime: float | None
    heard: float | None
    """As `uptime`, including the time in which the injector cut the agent from the ground."""
    alarms_per_fault: float | None
    missed: int
    false: int
    right: float | None
    nominal_s: float
    nominal_alarms: int
    off_changes: int | None
    """What changed in the world with recovery off; None: that run was not made."""
    bytes_nominal: float | None
    """Per agent and second, as the ground received them from PHM."""
    bytes_all: float | None
    cpu_nominal: float | None
    cpu_all: float | None
    rss_mb: float | None
    classes: tuple[OfClass, ...] = ()
    judged: tuple[Judged, ...] = field(default=(), repr=False)

    @property
    def beside(self) -> list[Alarm]:
        return [alarm for each in self.judged for alarm in each.beside]

    @property
    def clearing(self) -> list[Alarm]:
        return [alarm for each in self.judged for alarm in each.clearing]


def figures(trials: Sequence[Trial]) -> Figures:
    """All figures; trials may be any part of a campaign."""
    judged = tuple(judge(trial) for trial in trials)
    played = [each for each in judged if each.trial.kind == TRIAL]
    verdicts = [verdict for each in played for verdict in each.verdicts]
    nominal = [each for each in judged if each.trial.kind == NOMINAL]
    off = [each for each in judged if each.trial.kind == OFF]
    watched = [each.trial for each in judged if each.trial.kind != OFF]
    return Figures(
        agents=max((trial.agents for trial in trials), default=0),
        trials=len(played),
        injected=len(verdicts),
        not_injected=sum(each.moment is None for one in played for each in one.trial.injections),
        detection=stats(verdict.detected_s for verdict in verdicts),
        response=stats(verdict.response_s for verdict in verdicts),
        healing=stats(verdict.healed_s for verdict in verdicts),
        resolved_healable=_part(
            (verdict for verdict in verdicts if verdict.injection.healable), lambda each: each.healed_s is not None
        ),
        resolved=_part(verdicts, lambda each: each.healed_s is not None),
        uptime=uptime.share(watched),
        heard=uptime.share(watched, net=False),
        alarms_per_fault=_alarms(verdicts),
        missed=sum(verdict.missed for each in (*played, *off) for verdict in each.verdicts),
        false=sum(len(each.false) for each in judged),
        right=_part(verdicts, lambda each: each.right),
        nominal_s=math.fsum(each.trial.seconds for each in nominal),
        nominal_alarms=sum(len(each.false) for each in nominal),
        off_changes=sum(len(each.trial.changed) for each in off) if off else None,
        bytes_nominal=_rate([each.trial for each in nominal]),
        bytes_all=_rate(watched),
        cpu_nominal=_cpu(cost for each in nominal for cost in each.trial.cost),
        cpu_all=_cpu(cost for each in watched for cost in each.cost),
        rss_mb=max((cost.rss_mb for each in watched for cost in each.cost), default=None),
        classes=tuple(_of_class(name, verdicts) for name in sorted({each.injection.fault for each in verdicts})),
        judged=judged,
    )


def _of_class(name: str, verdicts: Sequence[Verdict]) -> OfClass:
    mine = [verdict for verdict in verdicts if verdict.injection.fault == name]
    first = mine[0].injection
    return OfClass(
        fault=name,
        title=first.title,
        layer=first.layer,
        healable=first.healable,
        injected=len(mine),
        detection=stats(verdict.detected_s for verdict in mine),
        response=stats(verdict.response_s for verdict in mine),
        healing=stats(verdict.healed_s for verdict in mine),
        resolved=sum(verdict.healed_s is not None for verdict in mine),
        missed=sum(verdict.missed for verdict in mine),
        wrong=sum(bool(verdict.wrong) for verdict in mine),
        alarms=_alarms(mine),
    )


def _alarms(verdicts: Iterable[Verdict]) -> float | None:
    """Alarms per expected alarm, of the reported faults only: a missed one must not compensate for a chain."""
    reported = [verdict for verdict in verdicts if not verdict.missed]
    due = sum(verdict.expected for verdict in reported)
    return sum(verdict.count for verdict in reported) / due if due else None


def _part(verdicts: Iterable[Verdict], wanted: Callable[[Verdict], bool]) -> float | None:
    found = [wanted(verdict) for verdict in verdicts]
    return sum(found) / len(found) if found else None


def _rate(trials: Sequence[Trial]) -> float | None:
    seconds = math.fsum(trial.seconds * trial.agents for trial in trials)
    return sum(sum(trial.received.values()) for trial in trials) / seconds if seconds > 0 else None


def _cpu(costs: Iterable[Cost]) -> float | None:
    """Mean over agents and time."""
    known = list(costs)
    seconds = math.fsum(cost.seconds for cost in known)
    return 100.0 * math.fsum(cost.cpu_s for cost in known) / seconds if seconds > 0 else None
