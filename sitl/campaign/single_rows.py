"""The table of faults by whether another one was on their agent at the same time, as text rows. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from sitl.campaign.groups import Group
from sitl.campaign.metrics import Figures
from sitl.campaign.stats import stats
from sitl.campaign.table import Rows, number
from sitl.campaign.trial import TRIAL
from sitl.campaign.verdict import Verdict

SIDES = {True: "the only one", False: "with others"}


def rows(groups: Sequence[Group]) -> Rows:
    """The figures of those that were the only fault of their agent, then of those with others."""
    return [
        (f"{words}: {name}", *(shown(verdicts(group.all, single=single)) for group in groups))
        for single, words in SIDES.items()
        for name, shown in _SHOWN
    ]


def verdicts(found: Figures, *, single: bool) -> list[Verdict]:
    """Of the injected faults whose agent had no other one in that trial, or had another. One that could not be injected is none."""
    chosen = []
    for each in found.judged:
        agents = [verdict.injection.agent for verdict in each.verdicts]
        if each.trial.kind == TRIAL:
            chosen += [one for one in each.verdicts if (agents.count(one.injection.agent) == 1) is single]
    return chosen


def _part(wanted: Callable[[Verdict], bool], of: Callable[[Verdict], bool] = lambda _: True) -> _Shown:
    """So many of those."""

    def shown(found: Sequence[Verdict]) -> str:
        among = [each for each in found if of(each)]
        return f"{sum(map(wanted, among))} of {len(among)}" if among else "-"

    return shown


def _mean(value: Callable[[Verdict], float | None]) -> _Shown:
    return lambda found: number(stats(map(value, found)).mean, "{:.2f} s")


def _first_otherwise(verdict: Verdict) -> bool:
    """Its cause counts as right, but its unit was first known with a condition that the fault does not have: perhaps what its
    injection did on the way."""
    fault = verdict.injection
    first = next((each for each in verdict.since if (each.agent, each.unit) == (fault.agent, fault.unit)), None)
    return verdict.right and first is not None and first.conditions[0] not in (fault.condition, fault.earlier)


_Shown = Callable[[Sequence[Verdict]], str]
_SHOWN: tuple[tuple[str, _Shown], ...] = (
    ("injected", lambda found: str(len(found))),
    ("detected at their unit", _part(lambda each: each.detected_s is not None)),
    ("missed", _part(lambda each: each.missed)),
    ("cause right", _part(lambda each: each.right)),
    ("of these, first known as something else", lambda found: str(sum(map(_first_otherwise, found)))),
    ("healable, ended by action", _part(lambda each: each.by_action, lambda each: each.injection.healable)),
    ("detection, mean", _mean(lambda each: each.detected_s)),
    ("recovery by action, mean", _mean(lambda each: each.recovered_s if each.by_action else None)),
)
