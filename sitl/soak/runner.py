"""Runs the swarm for hours: long spans in which nothing is injected, and between them single faults."""

from __future__ import annotations

import gzip
import random
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from sitl.campaign.fault_catalog import chosen, kind
from sitl.campaign.plan import Draw, TrialPlan
from sitl.campaign.profiles import ALL, Profile
from sitl.campaign.runner import Runner
from sitl.campaign.trial import NOMINAL, TRIAL, Trial, append, from_json
from sitl.faults import all_faults
from sitl.faults.base import Fault
from sitl.soak.sampler import Sampler
from sitl.swarm.swarm import Swarm

PROFILE: Profile = ALL["shipped"]
KINDS = frozenset(
    {"autopilot", "container", "devices", "gcs", "health", "network", "nodes", "peers", "radio", "router", "topics"}
)
NOT = frozenset({"clock_stepped", "memory_leak", "network_lost_together", "phm_killed_in_restart", "power_loss"})
"""They end PHM too, or take more than a minute: a restart would hide what grows."""
LEAST_S = 5.0
"""Less than this left is not worth another run."""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """seconds: to observe in all. every_s: how long nothing is injected between two faults. period_s: of the samples."""

    seconds: float
    every_s: float
    period_s: float
    seed: int


def soak_faults(faults: Mapping[str, Fault], agents: int) -> dict[str, Fault]:
    """Those that a soak injects: none that restarts PHM or changes its configuration, none that all agents of the machine see."""
    found = chosen(faults, (), agents, PROFILE, air=True)
    return {
        name: fault
        for name, fault in found.items()
        if kind(fault) in KINDS and name not in NOT and not fault.needs & {"configuration", "alone", "starvation"}
    }


def draws(names: Collection[str], agents: int, seed: int) -> Iterator[Draw]:
    """Without end: all faults in a random order, then again; each on a random agent."""
    rng = random.Random(f"phm-soak/{seed}")
    while True:
        for name in rng.sample(sorted(names), len(names)):
            yield Draw(name, rng.randint(1, agents))


def load(path: Path) -> list[Trial]:
    """All runs of the record (``.gz``: compressed), interrupted ones too. A line that was truncated by a kill is skipped; a missing file
    has none."""
    found = []
    content = path.read_bytes() if path.exists() else b""
    for line in (gzip.decompress(content) if path.suffix == ".gz" else content).splitlines():
        try:
            found.append(from_json(line))
        except ValueError:
            continue
    return found


def observed_s(trials: Collection[Trial]) -> float:
    return sum(max(0.0, trial.seconds) for trial in trials)


class Soak:
    """One session. What it learns is in the two files immediately, so it may be interrupted at any time."""

    def __init__(self, swarm: Swarm, plan: Plan, record: Path, samples: Path, progress: Progress) -> None:
        self._plan, self._record, self._progress = plan, record, progress
        faults = soak_faults(all_faults(), len(swarm.agents))
        self._runner = Runner(swarm, faults, PROFILE, progress)
        self._runner.on_end = lambda trial: append(record, trial)
        self._sampler = Sampler(self._runner.agents, samples, plan.period_s)
        self._draws = draws(faults, len(swarm.agents), plan.seed)

    def run(self) -> None:
        """Until all is observed. An error or an interrupt ends it after what was observed is recorded."""
        done = load(self._record)
        left_s, number = self._plan.seconds - observed_s(done), sum(trial.kind == TRIAL for trial in done)
        for _ in range(number):
            next(self._draws)
        try:
            self._runner.start()
            self._sampler.start()
            while left_s >= LEAST_S:
                quiet_s = min(self._plan.every_s, left_s)
                left_s -= self._once(NOMINAL, 0, partial(self._runner.nominal, quiet_s)).seconds
                if left_s < self._plan.every_s / 2:
                    continue
                number += 1
                one = TrialPlan(number, (next(self._draws),))
                self._progress(f"{left_s / 60:.0f} min left; {one.draws[0].fault} on A{one.draws[0].agent:02d}")
                left_s -= self._once(TRIAL, number, partial(self._runner.trial, one)).seconds
        finally:
            self._sampler.stop()
            self._runner.stop()

    def _once(self, kind: str, number: int, make: Callable[[], Trial]) -> Trial:
        before = time.monotonic()
        try:
            return make()
        except BaseException as error:
            ended = self._runner.aborted(kind, number, error)
            if ended.began >= before:
                append(self._record, ended)
            raise
