"""How much of the time each unit, layer, container, node and topic was not in ERROR, and how long nothing was known about it."""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from phm.review.agent_record import AgentRecord
from phm.review.levels import RANK, Segment, of_agent, seconds
from phm.review.omitted import OmittedCounts

Json = dict[str, Any]
KINDS = {
    "container": "container",
    "health": "container",
    "nodes": "node",
    "node_ready": "node",
    "topics": "topic",
    "rates": "topic",
    "data": "topic",
}
"""The kind of subject that the units of a check have."""
RANK_KNOWN = ("ERROR", "WARN", "OK", "STALE")
"""One unit that is never known must not hide for how long the others were OK."""
MOST_ROWS = 2000
"""Of one agent."""


def rows(
    agent: AgentRecord, units: Mapping[str, Sequence[Segment]], begin: float, end: float, omitted: OmittedCounts
) -> list[Json]:
    """One row for each layer, container, node and topic of the agent, and one for the agent (`kind` agent)."""
    about = {unit: body for run, _ in agent.runs for unit, body in run.units.items()}
    groups: dict[tuple[str, str], list[Sequence[Segment]]] = {("agent", agent.name): list(units.values())}
    for unit, segments in units.items():
        body = about.get(unit, {})
        check, _, subject = unit.partition("/")
        if body.get("layer"):
            groups.setdefault(("layer", body["layer"]), []).append(segments)
        kind = KINDS.get(check)
        if kind and subject:
            groups.setdefault((kind, subject), []).append(segments)
    found = [
        _row(agent, kind, name, of_agent(each, agent.cover, RANK_KNOWN), begin, end)
        for (kind, name), each in groups.items()
    ]
    order = ("agent", "layer", "container", "node", "topic")
    ordered = sorted((row for row in found if row is not None), key=lambda row: (order.index(row["kind"]), row["name"]))
    return omitted.keep(agent.name, "availability: layers, containers, nodes and topics", ordered, MOST_ROWS)


def _row(
    agent: AgentRecord, kind: str, name: str, segments: Sequence[Segment], begin: float, end: float
) -> Json | None:
    spent = seconds(segments, begin, end)
    if not spent:
        return None
    known = sum(spent.get(level, 0.0) for level in RANK if level != "STALE")
    errors = spent.get("ERROR", 0.0)
    return {
        "agent": agent.name,
        "kind": kind,
        "name": name,
        "ok_s": round(spent.get("OK", 0.0), 3),
        "warn_s": round(spent.get("WARN", 0.0), 3),
        "error_s": round(errors, 3),
        "unknown_s": round(spent.get("STALE", 0.0), 3),
        "availability": None if known <= 0 else round(1 - errors / known, 6),
    }


def unknown(agent: AgentRecord, units: Mapping[str, Sequence[Segment]], begin: float, end: float) -> list[Json]:
    """Units that were STALE: blocked by a known fault, or not known at all."""
    causes = _causes(agent)
    found: list[Json] = []
    for unit, segments in units.items():
        spent = {True: 0.0, False: 0.0}
        for first, last, level in segments:
            if level == "STALE":
                for since, until, cause in _split(first, last, causes.get(unit, [])):
                    spent[bool(cause)] += max(0.0, min(until, end) - max(since, begin))
        if spent[True] + spent[False] > 0.05:
            row = {
                "agent": agent.name,
                "unit": unit,
                "blocked_s": round(spent[True], 3),
                "unknown_s": round(spent[False], 3),
            }
            found.append(row)
    return found


def _causes(agent: AgentRecord) -> dict[str, list[tuple[float, str]]]:
    """By unit: from when on which other unit was named as the cause."""
    found: dict[str, list[tuple[float, str]]] = {}
    for run, clock in agent.runs:
        for mono, unit, by in run.causes:
            found.setdefault(unit, []).append((clock.t(mono), by))
    for each in found.values():
        each.sort(key=_moment)
    return found


def _split(first: float, last: float, causes: Sequence[tuple[float, str]]) -> Iterator[Segment]:
    """The time from `first` to `last` by cause, which can end or begin while the unit is unknown."""
    place = bisect.bisect_right(causes, first + 1e-6, key=_moment)
    since, cause = first, causes[place - 1][1] if place else ""
    while place < len(causes) and causes[place][0] < last:
        t, by = causes[place]
        yield since, t, cause
        since, cause, place = t, by, place + 1
    yield since, last, cause


def _moment(cause: tuple[float, str]) -> float:
    return cause[0]
