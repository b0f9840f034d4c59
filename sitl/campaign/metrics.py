"""All figures of a campaign, computed from its trials alone. Each is defined in docs/development/campaign.md. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from sitl.campaign import uptime
from sitl.campaign.attempts import Attempt, attempts
from sitl.campaign.scoring import judge
from sitl.campaign.stats import Stats, stats
from sitl.campaign.trial import NOMINAL, OFF, TRIAL, Alarm, Cost, Injection, RaisedWarning, Trial
from sitl.campaign.verdict import ENDINGS, ScoredTrial, Verdict, counted


@dataclass(frozen=True)
class ClassMetrics:
    """All injections of one class of fault. Shares are from 0 to 1."""

    fault: str
    title: str
    layer: str
    healable: bool
    injected: int
    detection: Stats
    response: Stats
    recovery: Stats
    """By an action of PHM, confirmed from outside."""
    by_action: int
    claimed: int
    missed: int
    wrong: int
    alarms: float | None
    """Per expected alarm, of what was reported; None where none was expected."""
    evidence: str = ""
    evidence_s: float | None = None
    evidence_period_s: float = 0.0
    evidence_ratio: float | None = None
    """Mean of `Verdict.evidence_ratio`."""
    compared: int = 0
    """Number of injections in that mean."""
    disturbed: int = 0
    """Of these, `Verdict.disturbed`."""
    undisturbed_ratio: float | None = None
    """The mean of the others."""


@dataclass(frozen=True)
class Figures:
    """A campaign. Times in seconds, shares from 0 to 1, CPU in percent of one core."""

    agents: int
    trials: int
    injected: int
    not_injected: int
    detection: Stats
    evidence: Stats
    """`Verdict.evidence_limit_s` of the faults in `detection`."""
    response: Stats
    logged: Stats
    """Detection as the paper defines it."""
    published: Stats
    """Response as the paper defines it."""
    published_due: int
    """Of these, reports that were due after the end of the trial."""
    listed: Stats
    """Until a periodic report listed the fault as bad."""
    recovery: Stats
    """By an action of PHM, confirmed from outside."""
    recovery_other: Stats
    """PHM's claims about all other faults: ended by something else, or not confirmed."""
    by_action: float | None
    by_action_healable: float | None
    by_action_possible: float | None
    """The share that an action can end at all, of all injected."""
    endings: dict[str, int]
    """Faults by what has ended them, by PHM's record."""
    unconfirmed: int
    """Ended by an action by PHM's record; not observed from outside, or observed otherwise."""
    never_broken: int
    """Of these, faults whose world was never observed to be broken."""
    through_cause: int
    uptime: float | None
    received: float | None
    """As `uptime`, including the time in which the injector cut the agent from the ground."""
    alarms_per_fault: float | None
    lacking: int
    """Reported faults with fewer alarms than expected."""
    before: int
    """Alarms of side effects of the injection, before the fault existed."""
    missed: int
    false: int
    right: float | None
    unhelpful: int
    unfinished: int
    """Actions that were interrupted by the end of the trial."""
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
    pss_mb: float | None
    peak_mb: float | None
    without_cost: int
    """Agents of trials whose sidecar's cost was not measured."""
    restarts: int
    """Starts of PHM during trials, injected or not."""
    classes: tuple[ClassMetrics, ...] = ()
    judged: tuple[ScoredTrial, ...] = field(default=(), repr=False)

    @property
    def verdicts(self) -> list[Verdict]:
        """Of all injected faults, except those of the run with recovery off."""
        return [verdict for each in self.judged if each.trial.kind == TRIAL for verdict in each.verdicts]

    @property
    def attempts(self) -> list[Attempt]:
        return [attempt for each in self.judged if each.trial.kind != OFF for attempt in attempts(each.trial)]

    @property
    def beside(self) -> list[Alarm]:
        return [alarm for each in self.judged for alarm in each.beside]

    @property
    def app_broken(self) -> list[Alarm]:
        return [alarm for each in self.judged for alarm in each.app_broken]

    @property
    def clearing(self) -> list[Alarm | RaisedWarning]:
        return [alarm for each in self.judged for alarm in each.clearing]


def figures(trials: Sequence[Trial]) -> Figures:
    """All figures; trials may be any part of a campaign."""
    judged = tuple(judge(trial) for trial in trials)
    played = [each for each in judged if each.trial.kind == TRIAL]
    verdicts = [verdict for each in played for verdict in each.verdicts]
    nominal = [each for each in judged if each.trial.kind == NOMINAL]
    off = [each for each in judged if each.trial.kind == OFF]
    watched = [each.trial for each in judged if each.trial.kind != OFF]
    tried = [attempt for trial in watched for attempt in attempts(trial)]
    costs = [cost for trial in trials for cost in trial.cost]
    ended = Counter(verdict.ended_by for verdict in verdicts)
    return Figures(
        agents=max((trial.agents for trial in trials), default=0),
        trials=len(played),
        injected=len(verdicts),
        not_injected=sum(each.moment is None for one in played for each in one.trial.injections),
        detection=stats(verdict.detected_s for verdict in verdicts),
        evidence=stats(verdict.evidence_limit_s for verdict in verdicts if verdict.detected_s is not None),
        response=stats(verdict.response_s for verdict in verdicts),
        logged=stats(verdict.logged_s for verdict in verdicts),
        published=stats(verdict.published_s for verdict in verdicts),
        published_due=sum(verdict.published_due for verdict in verdicts),
        listed=stats(verdict.listed_s for verdict in verdicts),
        recovery=stats(verdict.recovered_s for verdict in verdicts if verdict.by_action),
        recovery_other=stats(verdict.claimed_s for verdict in verdicts if not verdict.by_action),
        by_action=_part(verdicts, lambda each: each.by_action),
        by_action_healable=_part(
            (verdict for verdict in verdicts if verdict.injection.healable), lambda each: each.by_action
        ),
        by_action_possible=_part(verdicts, lambda each: each.by_action_possible),
        endings={ending: ended[ending] for ending in ENDINGS},
        unconfirmed=sum(each.ended_by == ENDINGS[0] and not each.by_action for each in verdicts),
        never_broken=sum(each.never_broken for each in verdicts),
        through_cause=sum(each.through_cause for each in verdicts),
        uptime=uptime.share(watched),
        received=uptime.share(watched, net=False),
        alarms_per_fault=_alarms(verdicts),
        lacking=sum(bool(verdict.lacking) for verdict in verdicts),
        before=sum(len(verdict.before) for verdict in verdicts),
        missed=sum(verdict.missed for each in (*played, *off) for verdict in each.verdicts),
        false=sum(len(each.false) for each in judged),
        right=_part(verdicts, lambda each: each.right),
        unhelpful=sum(attempt.helped is False for attempt in tried),
        unfinished=sum(attempt.helped is None for attempt in tried),
        nominal_s=math.fsum(each.trial.seconds for each in nominal),
        nominal_alarms=sum(len(each.false) for each in nominal),
        off_changes=sum(len(each.trial.changed) for each in off) if off else None,
        bytes_nominal=_rate([each.trial for each in nominal]),
        bytes_all=_rate(watched),
        cpu_nominal=_cpu(cost for each in nominal for cost in each.trial.cost),
        cpu_all=_cpu(costs),
        rss_mb=_memory((cost.seconds, cost.rss_mb) for cost in costs),
        pss_mb=_memory((cost.seconds, cost.pss_mb) for cost in costs),
        peak_mb=max((cost.peak_mb or cost.rss_mb for cost in costs), default=None),
        without_cost=sum(trial.agents - len(trial.cost) for trial in trials),
        restarts=sum(len(trial.starts) for trial in watched),
        classes=_classes([each for one in played for each in one.trial.injections], verdicts),
        judged=judged,
    )


def _classes(injections: Sequence[Injection], verdicts: Sequence[Verdict]) -> tuple[ClassMetrics, ...]:
    """Of all faults that were to be injected: a class whose injections all failed has none injected."""
    first = {each.fault: each for each in reversed(injections)}
    return tuple(_of_class(first[name], verdicts) for name in sorted(first))


def _of_class(first: Injection, verdicts: Sequence[Verdict]) -> ClassMetrics:
    mine = [verdict for verdict in verdicts if verdict.injection.fault == first.fault]
    compared = [verdict for verdict in mine if verdict.evidence_ratio is not None]
    return ClassMetrics(
        fault=first.fault,
        title=first.title,
        layer=first.layer,
        healable=first.healable,
        injected=len(mine),
        detection=stats(verdict.detected_s for verdict in mine),
        response=stats(verdict.response_s for verdict in mine),
        recovery=stats(verdict.recovered_s for verdict in mine if verdict.by_action),
        by_action=sum(verdict.by_action for verdict in mine),
        claimed=sum(verdict.claimed_s is not None for verdict in mine),
        missed=sum(verdict.missed for verdict in mine),
        wrong=sum(bool(verdict.wrong) for verdict in mine),
        alarms=_alarms(mine),
        evidence=first.evidence,
        evidence_s=first.evidence_s,
        evidence_period_s=first.evidence_period_s,
        evidence_ratio=stats(verdict.evidence_ratio for verdict in compared).mean,
        compared=len(compared),
        disturbed=sum(verdict.disturbed for verdict in compared),
        undisturbed_ratio=stats(each.evidence_ratio for each in compared if not each.disturbed).mean,
    )


def _alarms(verdicts: Iterable[Verdict]) -> float | None:
    """Alarms per expected alarm of the reported faults. One is the least: neither a missed fault nor one with too few
    alarms compensates for a chain. Alarms after a missed fault was cleared are too many, too.
    """
    known = list(verdicts)
    due = sum(verdict.expected for verdict in known if not verdict.missed)
    excess = sum(counted(verdict.after) if verdict.missed else verdict.excess for verdict in known)
    return 1 + excess / due if due else None


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


def _memory(samples: Iterable[tuple[float, float | None]]) -> float | None:
    """Mean over agents and time."""
    known = [(seconds, value) for seconds, value in samples if value is not None]
    seconds = math.fsum(each for each, _ in known)
    return math.fsum(each * value for each, value in known) / seconds if seconds > 0 else None
