"""All seeds of one profile and load, which the report shows in one column. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sitl.campaign.limits import stated
from sitl.campaign.metrics import Figures, figures
from sitl.campaign.stats import Estimate, estimate
from sitl.campaign.trial import ABORTED, BUSY, QUIET, Trial

ORDER = ("shipped", "tuned", "as-found", "")
LOADS = (QUIET, BUSY, "")


@dataclass(frozen=True)
class Group:
    """`seeds`: the figures of each seed, in the order of the seeds' numbers in the campaign; `all`: of all trials.
    `aborted`: runs that were repeated, and are in no figure.
    """

    profile: str
    load: str
    trials: tuple[Trial, ...]
    seeds: tuple[Figures, ...]
    all: Figures
    aborted: tuple[Trial, ...] = ()

    @property
    def name(self) -> str:
        return ", ".join(word for word in (self.profile, self.load) if word) or "campaign"

    def mean(self, value: Callable[[Figures], float | int | None]) -> Estimate | None:
        """A figure over the seeds."""
        return estimate(value(each) for each in self.seeds)

    def settings(self, key: str) -> list[Any]:
        """The different values of a setting, in the order of the trials."""
        found = []
        for trial in self.trials:
            value = trial.setting.get(key)
            if value is not None and value not in found:
                found.append(value)
        return found

    @property
    def excluded(self) -> dict[str, str]:
        """Reason by name of each fault that this campaign does not inject."""
        return {name: why for trial in self.trials for name, why in trial.setting.get("excluded", {}).items()}

    @property
    def differences(self) -> list[dict[str, Any]]:
        """From what is shipped, over all trials."""
        found: list[dict[str, Any]] = []
        for trial in self.trials:
            found += [each for each in trial.setting.get("differences", ()) if each not in found]
        return found


def groups(trials: Sequence[Trial]) -> list[Group]:
    """One for each profile and load; the shipped configuration on a quiet machine first."""
    by: dict[tuple[str, str], dict[int, list[Trial]]] = {}
    for trial in trials:
        if trial.kind == ABORTED:
            continue
        profile, load, seed = trial.campaign
        by.setdefault((profile, load), {}).setdefault(seed, []).append(stated(trial))
    found = []
    for (profile, load), seeds in by.items():
        ordered = sorted(seeds.values(), key=lambda each: int(each[0].setting.get("index", 0)))
        mine = tuple(trial for seed in ordered for trial in seed)
        aborted = tuple(each for each in trials if each.kind == ABORTED and each.campaign[:2] == (profile, load))
        found.append(Group(profile, load, mine, tuple(figures(each) for each in ordered), figures(mine), aborted))
    return sorted(found, key=lambda each: (_place(LOADS, each.load), _place(ORDER, each.profile)))


def _place(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else len(names)
