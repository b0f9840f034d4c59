"""What grows: the slope of each measurement, with its confidence interval. Pure.

The slope is that of `phm.core.trend`: the median over all pairs of points (Theil, Sen), with an interval that allows for points that
are correlated in time. The points are means of equal parts of the time, of one agent or over all agents.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from statistics import fmean

from phm.core.trend import line
from sitl.soak.sample import Sample

PARTS = 96
SETTLE_SHARE, SETTLE_S = 1 / 6, 600.0
"""The first sixth of a run, and at most its first ten minutes, is not counted: a program that has just started grows."""
HOUR_S = 3600.0
Point = tuple[float, float]
Points = list[Point]


@dataclass(frozen=True)
class Measurement:
    """value: of one sample. total: it is a counter, so its rate per second is looked at."""

    name: str
    unit: str
    value: Callable[[Sample], float]
    total: bool = False


MEASUREMENTS = (
    Measurement("memory, resident", "MB", lambda it: it.resident_mb),
    Measurement("memory, private", "MB", lambda it: it.private_mb),
    Measurement("descriptors", "", lambda it: it.descriptors),
    Measurement("threads", "", lambda it: it.threads),
    Measurement("CPU", "% of a core", lambda it: 100 * it.cpu_s, total=True),
    Measurement("wake-ups", "/s", lambda it: it.wakeups, total=True),
    Measurement("log on disk", "MB", lambda it: it.log_bytes / 1e6),
)


@dataclass(frozen=True)
class Growth:
    """Per hour; None: too few points. mean: of the values themselves."""

    mean: float
    slope: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def verdict(self) -> str:
        if self.low is None or self.high is None:
            return "too short"
        return "grows" if self.low > 0 else "falls" if self.high < 0 else "no trend"


@dataclass(frozen=True)
class Row:
    """of: by the agent's number. worst: the agent with the largest slope; None: none is known."""

    measurement: Measurement
    all: Growth
    of: dict[int, Growth]

    @property
    def worst(self) -> int | None:
        known = {agent: growth.slope for agent, growth in self.of.items() if growth.slope is not None}
        return max(known, key=lambda agent: known[agent], default=None)


def longest_runs(samples: Sequence[Sample]) -> dict[int, list[Sample]]:
    """Of each agent, the samples of the daemon that ran longest, without its first part: a restart would hide what grows."""
    by_agent: dict[int, list[Sample]] = defaultdict(list)
    for sample in samples:
        by_agent[sample.agent].append(sample)
    found = {}
    for agent, mine in sorted(by_agent.items()):
        runs = [list(run) for _, run in groupby(mine, key=lambda it: it.run)]
        longest = max(runs, key=lambda run: run[-1].mono - run[0].mono)
        settled = longest[0].mono + min(SETTLE_S, SETTLE_SHARE * (longest[-1].mono - longest[0].mono))
        found[agent] = [sample for sample in longest if sample.mono >= settled]
    return found


def restarts(samples: Sequence[Sample]) -> int:
    """How often a daemon was another one than in the sample before."""
    last: dict[int, str] = {}
    count = 0
    for sample in samples:
        count += last.get(sample.agent, sample.run) != sample.run
        last[sample.agent] = sample.run
    return count


def points(samples: Sequence[Sample], of: Measurement) -> Points:
    """Value, or rate of a counter, over time in seconds."""
    if not of.total:
        return [(it.mono, of.value(it)) for it in samples]
    return [
        (later.mono, (of.value(later) - of.value(earlier)) / (later.mono - earlier.mono))
        for earlier, later in pairwise(samples)
        if later.mono > earlier.mono and of.value(later) >= of.value(earlier)
    ]


def averaged(series: Sequence[Points], parts: int = PARTS) -> Points:
    """Means of equal parts of the time, in which each series counts the same. A part that lacks one of the series is left out."""
    every = [point for each in series for point in each]
    if not every:
        return []
    begin, end = min(at for at, _ in every), max(at for at, _ in every)
    width = max((end - begin) / parts, 1e-9)
    sums: dict[int, dict[int, list[float]]] = defaultdict(lambda: defaultdict(list))
    for number, each in enumerate(series):
        for at, value in each:
            sums[min(parts - 1, int((at - begin) / width))][number].append(value)
    return [
        (begin + (part + 0.5) * width, fmean(fmean(values) for values in mine.values()))
        for part, mine in sorted(sums.items())
        if len(mine) == len(series)
    ]


def growth(series: Sequence[Points]) -> Growth:
    """Of one agent's points, or of those of several agents together."""
    found = averaged(series)
    mean = fmean(value for _, value in found) if found else 0.0
    slope = line(found)
    if slope is None:
        return Growth(mean)
    return Growth(mean, slope.slope * HOUR_S, slope.low * HOUR_S, slope.high * HOUR_S)


def rows(samples: Sequence[Sample]) -> list[Row]:
    """One for each measurement."""
    runs = longest_runs(samples)
    made = []
    for measurement in MEASUREMENTS:
        series = {agent: points(mine, measurement) for agent, mine in runs.items()}
        of = {agent: growth([mine]) for agent, mine in series.items()}
        made.append(Row(measurement, growth(list(series.values())), of))
    return made
