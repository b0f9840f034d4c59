"""The report as one JSON object, of which every output is made. Its keys are a contract: docs/reference/report.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from phm import __version__
from phm.review import (
    agent_row,
    availability,
    check_rates,
    fault_list,
    injection_metrics,
    levels,
    own_figures,
    plots,
    sentences,
)
from phm.review.clocks import REFERENCE
from phm.review.flights import Flight, flights
from phm.review.omitted import OmittedCounts
from phm.review.record import Record
from phm.review.spans import clipped, total

Json = dict[str, Any]
VERSION = 1
"""`report` of the object; raised when a key changes its meaning or is removed."""
MOST_OTHER = 20_000
MOST_UNKNOWN = 2000
MOST_STEPS = 50
"""Steps of the UTC of one run."""
MARGIN_S = 2.0
"""A flight is shown with so much before and after it."""
NO_GROUND = (
    "no record of the ground (`phm gcs --record`) is among the files, so times are by the agents' own clocks and may be wrong by as "
    "much as these; agents that received the same heartbeats are compared with each other"
)


class NoFlight(Exception):
    """The record has no such flight; the message lists those that it has."""


def build(record: Record, flight: int | None = None) -> Json:
    """flight: number of a flight, None: the whole record. Raises NoFlight."""
    flown = flights(record)
    begin, end = _window(record, flown, flight)
    rows: list[Json] = []
    faults: list[Json] = []
    available: list[Json] = []
    unknown: list[Json] = []
    observed: dict[str, float] = {}
    omitted = OmittedCounts()
    for agent in record.agents:
        units = levels.of_units(agent)
        mine = fault_list.rows(agent, begin, end, omitted)
        faults += mine
        available += availability.rows(agent, units, begin, end, omitted)
        unknown += availability.unknown(agent, units, begin, end)
        for run, clock in agent.runs:
            ran_s = total(clipped(([clock.t(at) for at in span] for span in run.cover.spans), begin, end))
            for check in {body["check"] for body in run.units.values()} if ran_s else ():
                observed[check] = observed.get(check, 0.0) + ran_s
        rows.append(agent_row.row(record, agent, units, mine, begin, end, omitted))
    faults.sort(key=lambda fault: (fault["opened"], fault["agent"]))
    uptimes = {row["agent"]: row["uptime"] for row in rows if row["uptime"] is not None}
    document: Json = {
        "report": VERSION,
        "phm_version": __version__,
        "window": {
            "begin": round(begin, 3),
            "end": round(end, 3),
            "duration_s": round(end - begin, 3),
            "flight": flight,
        },
        "sentences": [],
        "flights": [_flight(one) for one in flown],
        "agents": rows,
        "faults": faults,
        "availability": available,
        "checks": check_rates.rows(check_rates.opened(faults, round(begin, 3)), observed),
        "unknown": omitted.keep("", "units that were not known for a time", _longest(unknown), MOST_UNKNOWN),
        "phm": own_figures.build(record, uptimes, begin, end, whole=flight is None),
        "clocks": _clocks(record, omitted),
        "plots": plots.rows(record, begin, end, omitted),
        "other": _others(record, begin, end),
        "injection_metrics": injection_metrics.build(
            [agent for agent in record.agents if agent.vehicle], faults, uptimes, begin, end
        ),
        "files": _files(record),
    }
    document["cut"] = omitted.rows()
    document["sentences"] = sentences.build(document)
    return document


def _window(record: Record, flown: list[Flight], number: int | None) -> tuple[float, float]:
    if number is None:
        return record.begin, record.end
    for flight in flown:
        if flight.number == number:
            return max(record.begin, flight.begin - MARGIN_S), min(record.end, flight.end + MARGIN_S)
    known = ", ".join(f"{flight.number} ({sentences.length(flight.end - flight.begin)})" for flight in flown)
    raise NoFlight(
        f"flight {number} is not in the record: it has {f'flights {known}' if known else 'none, no autopilot was armed'}"
    )


def _flight(flight: Flight) -> Json:
    times = {
        "begin": round(flight.begin, 3),
        "end": round(flight.end, 3),
        "duration_s": round(flight.end - flight.begin, 3),
    }
    return {"number": flight.number, **times, "agents": list(flight.agents)}


def _longest(unknown: list[Json]) -> list[Json]:
    return sorted(unknown, key=lambda row: -(row["unknown_s"] + row["blocked_s"]))


def _clocks(record: Record, omitted: OmittedCounts) -> Json:
    rows = []
    for agent in record.agents:
        for run, clock in agent.runs:
            steps = [[round(clock.t(mono), 3), round(step, 3)] for mono, step in clock.steps]
            rows.append(
                {
                    "agent": agent.name,
                    "boot_id": run.boot_id,
                    "offset_s": None if clock.offset_s is None else round(clock.offset_s, 3),
                    "error_s": None if clock.error_s is None else round(clock.error_s, 3),
                    "votes": clock.votes,
                    "applied": clock.applied,
                    "by": clock.by,
                    "steps": omitted.keep(agent.name, "jumps of the UTC of a run", steps, MOST_STEPS),
                }
            )
    chosen = (agent.name for agent in record.agents for _, clock in agent.runs if clock.by == REFERENCE)
    return {
        "reference": "ground" if record.grounds else next(chosen, "each agent"),
        "missing": "" if record.grounds else NO_GROUND,
        "runs": rows,
        "others": [
            {
                "file": Path(clock.file).name,
                "offset_s": None if clock.offset_s is None or not clock.placed else round(clock.offset_s, 3),
                "error_s": None if clock.error_s is None else round(clock.error_s, 3),
                "lines": clock.lines,
                "applied": clock.offset_s is not None,
                "by": clock.by,
            }
            for clock in record.external_clocks
            if clock.placed or clock.offset_s is not None
        ],
    }


def _others(record: Record, begin: float, end: float) -> Json:
    names = {agent.id: agent.name for agent in record.agents if agent.id}
    inside = [other for other in record.others if begin <= other.t <= end]
    rows = [
        {
            "t": round(other.t, 3),
            "agent": names[other.system] if other.system else record.recordings[other.file],
            "system": other.system,
            "what": other.what,
            "text": other.text,
            "level": other.level,
            "by": other.by,
            "file": Path(other.file).name,
        }
        for other in inside[:MOST_OTHER]
    ]
    return {"outside": len(record.others) - len(inside), "left_out": len(inside) - len(rows), "rows": rows}


def _files(record: Record) -> Json:
    problems = record.part.problems
    found = [
        {"what": what, "file": path, "count": count, "line": line}
        for (what, path), (count, line) in problems.found.items()
    ]
    grounds = [
        {
            "run": ground.run,
            "version": ground.version,
            "lines": ground.lines,
            "lost_lines": sum(ground.lost.values()),
            "missing_lines": ground.missing_lines,
            "left_out": ground.left_out,
        }
        for ground, _ in record.grounds
    ]
    return {
        "lines": record.part.lines,
        "bytes": record.part.bytes,
        "grounds": grounds,
        "problems": found,
        "more_problems": problems.more,
    }
