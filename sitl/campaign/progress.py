"""How much of the planned campaigns a record has. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sitl.campaign.trial import TRIAL, Trial


@dataclass(frozen=True)
class Progress:
    """Of one profile and load. A seed is complete with all its trials."""

    trials: int
    planned: int
    seeds: int
    planned_seeds: int
    missing: int
    """Planned trials that are not in the record."""

    @property
    def words(self) -> str:
        """Empty: nothing is missing."""
        if not self.missing:
            return ""
        return (
            f"incomplete: {self.trials} of {self.planned} trials, {self.seeds} of {self.planned_seeds} seeds complete"
        )


def progress(trials: Sequence[Trial]) -> Progress:
    """Of the trials of one profile and load; those of seeds that were not begun are planned, too."""
    planned = {trial.campaign: int(trial.setting.get("planned", 0)) for trial in trials}
    made = [trial.campaign for trial in trials if trial.kind == TRIAL]
    lacking = {campaign: max(0, number - made.count(campaign)) for campaign, number in planned.items()}
    wanted = max([len(planned), *(int(trial.setting.get("seeds", 1)) for trial in trials)])
    missing = sum(lacking.values()) + (wanted - len(planned)) * max(planned.values(), default=0)
    complete = sum(not number for number in lacking.values())
    return Progress(len(made), len(made) + missing, complete, wanted, missing)


def left(trials: Sequence[Trial]) -> int:
    """Planned trials of all profiles and loads that are not in the record."""
    kinds = {trial.campaign[:2] for trial in trials}
    return sum(progress([trial for trial in trials if trial.campaign[:2] == kind]).missing for kind in kinds)
