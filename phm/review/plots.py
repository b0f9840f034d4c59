"""Measurements over time, as the page draws them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from phm.review.agent_record import AgentRecord
from phm.review.omitted import OmittedCounts
from phm.review.record import Record
from phm.review.spans import Span

Json = dict[str, Any]
MOST_POINTS = 150_000
GAP_S = 1.0
"""A shorter gap between two runs is not shown."""


def rows(record: Record, begin: float, end: float, omitted: OmittedCounts) -> list[Json]:
    """`agent`, `name` and `points` of each measurement in the window; a value None: nothing was recorded from there to the next one."""
    for agent in record.agents:
        left_out = {name for run, _ in agent.runs for name in run.unplotted}
        omitted.add(agent.name, "measurements without a plot", len(left_out))
    found = [plot for agent in record.agents for plot in _of_agent(agent, begin, end)]
    return _thinned(found + _of_ground(record, begin, end))


def _of_agent(agent: AgentRecord, begin: float, end: float) -> list[Json]:
    found: dict[str, list[list[float]]] = {}
    for run, clock in agent.runs:
        for name, series in run.series.items():
            points = [
                [round(clock.t(at), 2), round(value, 4)] for at, value in series.points() if begin <= clock.t(at) <= end
            ]
            found.setdefault(name, []).extend(points)
    return [
        {"agent": agent.name, "name": name, "points": _with_gaps(sorted(points), agent.cover)}
        for name, points in sorted(found.items())
        if len(points) > 1
    ]


def _of_ground(record: Record, begin: float, end: float) -> list[Json]:
    found = []
    for ground, clock in record.grounds:
        for name, series in ground.series.items():
            points = [[round(clock.t(at), 2), value] for at, value in series.points() if begin <= clock.t(at) <= end]
            cover = [[clock.t(first), clock.t(last)] for first, last in ground.cover.spans]
            found.append({"agent": "ground", "name": name, "points": _with_gaps(points, cover)})
    return [plot for plot in found if len(plot["points"]) > 1]


def _with_gaps(points: Sequence[list[Any]], cover: Sequence[Span]) -> list[list[Any]]:
    """A point without a value in each gap of the record: a line through it would show what no one has measured."""
    breaks = [
        round((before[1] + after[0]) / 2, 2)
        for before, after in itertools.pairwise(cover)
        if after[0] - before[1] > GAP_S
    ]
    found: list[list[Any]] = []
    place = 0
    for point in points:
        while place < len(breaks) and breaks[place] < point[0]:
            if found and found[-1][1] is not None:
                found.append([breaks[place], None])
            place += 1
        found.append(point)
    return found


def _thinned(plots: list[Json]) -> list[Json]:
    """At most MOST_POINTS in all, and the gaps: every second, third ... point of each where there are many."""
    step = 1 + sum(len(plot["points"]) for plot in plots) // MOST_POINTS
    return [
        {**plot, "points": [one for place, one in enumerate(plot["points"]) if not place % step or one[1] is None]}
        for plot in plots
    ]
