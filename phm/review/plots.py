"""Measurements over time, as the page draws them."""

from __future__ import annotations

from typing import Any

from phm.review.omitted import OmittedCounts
from phm.review.record import AgentRecord, Record

Json = dict[str, Any]
MOST_POINTS = 150_000


def rows(record: Record, begin: float, end: float, omitted: OmittedCounts) -> list[Json]:
    """`agent`, `name` and `points` of each measurement in the window."""
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
        {"agent": agent.name, "name": name, "points": sorted(points)}
        for name, points in sorted(found.items())
        if len(points) > 1
    ]


def _of_ground(record: Record, begin: float, end: float) -> list[Json]:
    found = []
    for ground, clock in record.grounds:
        for name, series in ground.series.items():
            points = [[round(clock.t(at), 2), value] for at, value in series.points() if begin <= clock.t(at) <= end]
            found.append({"agent": "ground", "name": name, "points": points})
    return [plot for plot in found if len(plot["points"]) > 1]


def _thinned(plots: list[Json]) -> list[Json]:
    """At most MOST_POINTS in all: every second, third ... point of each where there are many."""
    step = 1 + sum(len(plot["points"]) for plot in plots) // MOST_POINTS
    return [{**plot, "points": plot["points"][::step]} for plot in plots]
