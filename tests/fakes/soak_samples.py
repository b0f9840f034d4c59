"""Samples and runs of a soak that did not take place."""

from __future__ import annotations

from collections.abc import Callable

from sitl.campaign.trial import NOMINAL, Trial
from sitl.soak.sample import Sample

SETTING = {
    "seconds": 7200.0,
    "every_s": 600.0,
    "period_s": 10.0,
    "agents": 2,
    "seed": 1,
    "commit": "0123abc",
    "machine": "x86_64, 2 cores",
    "profile": "shipped",
}


PERIOD_S = 10.0


def sample(agent: int, at_s: float, run: str = "1/7", memory_mb: float = 60.0, wakeups: int = 0) -> Sample:
    return Sample(1000 + at_s, 1e9 + at_s, agent, run, memory_mb + 10, memory_mb, 20, 9, at_s / 100, wakeups, 1000)


def samples(memory: Callable[[int, float], float], hours: float = 2.0, agents: int = 2) -> list[Sample]:
    """Of two hours; memory: of an agent at a time, in MB."""
    times = [place * PERIOD_S for place in range(int(hours * 3600 / PERIOD_S))]
    return [
        sample(agent, at_s, memory_mb=memory(agent, at_s), wakeups=int(5 * at_s))
        for at_s in times
        for agent in range(1, agents + 1)
    ]


def quiet(seconds: float, agents: int = 8, **more: object) -> Trial:
    made = Trial(NOMINAL, 0, agents, began=100.0, utc=0.0, ended=100.0 + seconds)
    for name, value in more.items():
        setattr(made, name, value)
    return made
