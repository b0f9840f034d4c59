"""False alarms per agent hour, and what became of the rare faults. Pure; the rules are those of the campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from phm.review.statistics import rate_limits
from sitl.campaign.scoring import judge
from sitl.campaign.trial import ABORTED, Trial


@dataclass(frozen=True)
class Alarms:
    """agent_hours: observed. low, high: 95 % limits of the false alarms per agent hour. listed: the false alarms in words;
    not_seen: the missed faults."""

    agent_hours: float
    false: int
    low: float
    high: float
    injected: int
    missed: int
    by_action: int
    listed: tuple[str, ...]
    not_seen: tuple[str, ...]

    @property
    def per_agent_hour(self) -> float | None:
        return self.false / self.agent_hours if self.agent_hours > 0 else None


def count(trials: Sequence[Trial]) -> Alarms:
    """Of all that was observed, also of a run that was interrupted; the fault of such a run counts as not injected."""
    judged = [judge(trial) for trial in trials]
    false = [(each.trial, alarm) for each in judged for alarm in each.false]
    verdicts = [verdict for each in judged if each.trial.kind != ABORTED for verdict in each.verdicts]
    hours = sum(max(0.0, trial.seconds) * trial.agents for trial in trials) / 3600
    low, high = rate_limits(len(false), hours)
    return Alarms(
        hours,
        len(false),
        low,
        high,
        len(verdicts),
        sum(verdict.missed for verdict in verdicts),
        sum(verdict.by_action for verdict in verdicts),
        tuple(
            f"A{alarm.agent:02d} {alarm.unit}, {alarm.mono - trial.began:.0f} s after the beginning of a run with "
            f"{', '.join(each.fault for each in trial.injections) or 'nothing injected'}: {alarm.summary}"
            for trial, alarm in false
        ),
        tuple(f"{each.injection.fault} on A{each.injection.agent:02d}" for each in verdicts if each.missed),
    )
