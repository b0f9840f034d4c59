"""What a campaign will do: its seeds, the trials of each, and how often each fault is injected."""

from __future__ import annotations

import argparse
import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from sitl.campaign import profiles, seeds
from sitl.campaign.fault_catalog import TIMES, WANTED, chosen, class_of, excluded
from sitl.campaign.plan import TrialPlan, counts, plan, trials_for
from sitl.campaign.profiles import Profile
from sitl.campaign.trial import TRIAL, Trial
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.harness.machine import machine

LEAST_TRIALS = 20
NOTED = "note"
"""Setting of trials whose injections PHM has noted in its log; others do not have it."""
NOT_NAMED = "it is not among the faults given with --only"
SAME = ("agents", "autopilot", "interval_s", "faults", NOTED)
"""Settings that trials of one profile and load must share."""


@dataclass(frozen=True)
class Schedule:
    """seeds: by index. plans: the trials of each. excluded: faults that are not injected, and why."""

    commit: str
    profile: Profile
    load: str
    seeds: tuple[int, ...]
    plans: tuple[tuple[TrialPlan, ...], ...]
    faults: Mapping[str, Fault]
    excluded: Mapping[str, str]
    common: Mapping[str, Any]

    @property
    def planned(self) -> int:
        """Trials in all."""
        return sum(len(trials) for trials in self.plans)

    @property
    def counts(self) -> Counter[str]:
        """How often each fault is injected."""
        return counts(self.plans)

    def setting(self, index: int) -> dict[str, Any]:
        """What is recorded in each trial of a seed."""
        return {
            **self.common,
            "seed": self.seeds[index],
            "index": index,
            "seeds": len(self.seeds),
            "commit": self.commit,
            "profile": self.profile.name,
            "load": self.load,
            "planned": len(self.plans[index]),
            "excluded": dict(self.excluded),
        }


def schedule(asked: argparse.Namespace) -> Schedule:
    """Of the options. Raises ValueError for invalid ones, LookupError when the commit is not known."""
    if asked.seed is None and asked.seeds < 1:
        raise ValueError(f"--seeds {asked.seeds}: a campaign has 1 seed or more")
    commit = seeds.full_id(asked.commit) if asked.commit else seeds.checked_out()
    numbers = (asked.seed,) if asked.seed is not None else tuple(seeds.seed_of(commit, at) for at in range(asked.seeds))
    profile, every = profiles.ALL[asked.profile], all_faults()
    faults = chosen(every, asked.only, asked.agents, profile, air=True)
    classes = [class_of(fault) for fault in faults.values()]
    trials = asked.trials
    if trials is None:
        times = 0 if asked.only or asked.seed is not None else TIMES
        trials = trials_for(numbers, asked.agents, LEAST_TRIALS, times, classes, WANTED)
    return Schedule(
        commit,
        profile,
        asked.load,
        numbers,
        plan(numbers, asked.agents, trials, classes, WANTED),
        faults,
        {name: NOT_NAMED for name in every if name not in faults}
        if asked.only
        else excluded(every, asked.agents, profile, air=True),
        {
            "agents": asked.agents,
            "autopilot": asked.autopilot,
            "interval_s": asked.interval,
            "faults": hashlib.sha256(",".join(sorted(faults)).encode()).hexdigest()[:12],
            "machine": machine(),
            "day": datetime.now(timezone.utc).date().isoformat(),
            **({NOTED: True} if asked.note else {}),
        },
    )


def check_record(done: Sequence[Trial], to_do: Schedule, file: Path) -> None:
    """Raise ValueError with the difference when a record cannot be continued with this schedule."""
    for trial in done:
        if trial.setting.get("commit") != to_do.commit:
            raise ValueError(
                f"{file} is the record of commit {trial.setting.get('commit')}, this is {to_do.commit}: name another file "
                "with --record, or continue that one with --commit"
            )
        if trial.campaign[:2] != (to_do.profile.name, to_do.load):
            continue
        other = [key for key in SAME if trial.setting.get(key) != to_do.common.get(key)]
        if other or not _planned(trial, to_do):
            what = f"other {', '.join(other)}" if other else "another number of seeds or trials"
            raise ValueError(
                f"{file} is the record of another campaign, with {what}: name another file with --record, or repeat the "
                "options with which it was begun"
            )


def _planned(trial: Trial, to_do: Schedule) -> bool:
    """Whether a recorded trial is one of the schedule; a seed or trial beyond it is left alone."""
    if trial.kind != TRIAL or trial.setting["seed"] not in to_do.seeds:
        return True
    trials = to_do.plans[to_do.seeds.index(trial.setting["seed"])]
    if trial.number > len(trials):
        return True
    return [(each.fault, each.agent) for each in trial.injections] == [
        (draw.fault, draw.agent) for draw in trials[trial.number - 1].draws
    ]
