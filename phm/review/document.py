"""The report as one JSON object, of which every output is made. Its keys are a contract: docs/reference/report.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phm import __version__
from phm.review import availability, check_rates, fault_list, levels, sentences, table2
from phm.review.clocks import REFERENCE
from phm.review.flights import Flight, flights
from phm.review.record import AgentRecord, Record
from phm.review.run import Run
from phm.review.spans import clipped, total, without

Json = dict[str, Any]
VERSION = 1
"""`report` of the object; raised when a key changes its meaning or is removed."""
MOST_POINTS = 150_000
MOST_OTHER = 20_000
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
    for agent in record.agents:
        units = levels.of_units(agent)
        mine = fault_list.rows(agent, begin, end)
        faults += mine
        available += availability.rows(agent, units, begin, end)
        unknown += availability.unknown(agent, units, begin, end)
        ran_s = total(clipped(agent.cover, begin, end))
        for check in {body["check"] for run, _ in agent.runs for body in run.units.values()}:
            observed[check] = observed.get(check, 0.0) + ran_s
        rows.append(_agent(record, agent, units, mine, begin, end))
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
        "unknown": sorted(unknown, key=lambda row: -(row["unknown_s"] + row["blocked_s"]))[:200],
        "phm": _own(record, uptimes),
        "clocks": _clocks(record),
        "plots": _thinned(
            [plot for agent in record.agents for plot in _plots(agent, begin, end)] + _ground_plots(record, begin, end)
        ),
        "other": _others(record, begin, end),
        "table2": table2.build(record.agents, faults, uptimes, begin, end),
        "files": _files(record),
    }
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


def _agent(
    record: Record,
    agent: AgentRecord,
    units: dict[str, list[levels.Segment]],
    faults: list[Json],
    begin: float,
    end: float,
) -> Json:
    worst = levels.of_agent(units.values(), agent.cover) if agent.runs else levels.of_ground(record, agent.id)
    spent = levels.seconds(worst, begin, end)
    first = max(begin, agent.cover[0][0]) if agent.cover else begin
    # A log that ends while its autopilot is armed was not ended by anyone: PHM, or its computer, was lost.
    flying = agent.flying and bool(agent.armed) and agent.armed[-1][1] >= agent.end - 1.0
    last = end if flying else min(end, agent.end)
    down = clipped(without([[first, last]], agent.cover), begin, end) if agent.runs and last > first else []
    lost = sum(mark.body["lines"] for _, mark in agent.marks if mark.what == "lost")
    # An event `lost` has the number of the last line that it counts; the others are a gap before it.
    explained = sum(max(0, mark.body["lines"] - 1) for _, mark in agent.marks if mark.what == "lost")
    gaps = sum(int(gap[1] - gap[0]) - 1 for run, _ in agent.runs for gap in run.numbers.gaps())
    missing = max(0, gaps - explained)
    return {
        "agent": agent.name,
        "agent_id": agent.id,
        "logged": bool(agent.runs),
        "versions": sorted({run.version for run, _ in agent.runs if run.version}),
        "runs": [
            {
                "boot_id": run.boot_id,
                "begin": round(clock.t(run.cover.spans[0][0]), 3),
                "end": round(clock.t(run.cover.spans[-1][1]), 3),
            }
            for run, clock in agent.runs
            if run.cover.spans
        ][:200],
        "faults": len(check_rates.opened(faults, round(begin, 3))),
        "error_s": round(spent.get("ERROR", 0.0), 3),
        "warn_s": round(spent.get("WARN", 0.0), 3),
        "unknown_s": round(spent.get("STALE", 0.0), 3),
        "uptime": round(1 - total(down) / (last - first), 6) if agent.runs and last > first else None,
        "down": _rounded(down),
        "armed": _rounded(clipped(agent.armed, begin, end)),
        "link_gaps": _rounded(clipped(levels.gaps(record, agent.id), begin, end)),
        "levels": [[round(a, 2), round(b, 2), level] for a, b, level in _clip(worst, begin, end)],
        "units": _shown_units(units, begin, end),
        "actions": [
            [round(t, 2), mark.body["action"], mark.body["phase"]]
            for t, mark in agent.marks
            if mark.what == "action"
            and begin <= t <= end
            and mark.body["phase"] in ("started", "verified", "failed", "escalated")
        ][:2000],
        "lost_lines": lost,
        "missing_lines": missing,
        "left_out": sum(run.left_out for run, _ in agent.runs),
    }


def _shown_units(units: dict[str, list[levels.Segment]], begin: float, end: float) -> dict[str, list[list[Any]]]:
    """Units that were not always well; the worst first."""
    spent = {unit: levels.seconds(segments, begin, end) for unit, segments in units.items()}
    bad = [unit for unit, by in spent.items() if any(by.get(level, 0.0) > 0.05 for level in ("ERROR", "WARN", "STALE"))]
    bad.sort(key=lambda unit: [-spent[unit].get(level, 0.0) for level in ("ERROR", "WARN", "STALE")])
    return {
        unit: [[round(a, 2), round(b, 2), level] for a, b, level in _clip(units[unit], begin, end)][:500]
        for unit in bad[:40]
    }


def _own(record: Record, uptimes: dict[str, float]) -> Json:
    """PHM about itself."""
    agents = []
    for agent in record.agents:
        if not agent.runs:
            continue
        runs = [run for run, _ in agent.runs]
        reports, timed = sum(len(run.reports) for run in runs), sum(run.report_s[2] for run in runs)
        checks: dict[str, list[float]] = {}
        for run in runs:
            for check, (count, whole, most) in run.check_ms.items():
                had = checks.setdefault(check, [0.0, 0.0, 0.0])
                checks[check] = [had[0] + count, had[1] + whole, max(had[2], most)]
        agents.append(
            {
                "agent": agent.name,
                "uptime": uptimes.get(agent.name),
                "restarts": len(runs) - 1,
                "cpu_percent": _cpu_percent(runs),
                "memory_bytes": max(run.memory_bytes for run in runs) or None,
                "sent_bytes": sum(run.cost[-1][2] - run.cost[0][2] for run in runs if run.cost) or None,
                "reports": reports,
                "report_mean_s": round(sum(run.report_s[0] for run in runs) / timed, 4) if timed else None,
                "report_longest_s": round(max(run.report_s[1] for run in runs), 4) if reports else None,
                "check_mean_ms": {
                    check: round(each[1] / each[0], 2) for check, each in sorted(checks.items()) if each[0]
                },
                "text_bytes": sum(ground.bytes_of.get(agent.id, 0) for ground, _ in record.grounds)
                if record.grounds
                else None,
            }
        )
    return {"uptime": round(sum(uptimes.values()) / len(uptimes), 6) if uptimes else None, "agents": agents}


def _cpu_percent(runs: Sequence[Run]) -> float | None:
    """CPU time of PHM per time, in percent of one core; None: the logs do not contain it."""
    known = [run.cost for run in runs if len(run.cost) > 1]
    seconds = sum(cost[-1][0] - cost[0][0] for cost in known)
    return round(100 * sum(cost[-1][1] - cost[0][1] for cost in known) / seconds, 2) if seconds > 0 else None


def _clocks(record: Record) -> Json:
    rows = []
    for agent in record.agents:
        for run, clock in agent.runs:
            rows.append(
                {
                    "agent": agent.name,
                    "boot_id": run.boot_id,
                    "offset_s": None if clock.offset_s is None else round(clock.offset_s, 3),
                    "error_s": None if clock.error_s is None else round(clock.error_s, 3),
                    "votes": clock.votes,
                    "applied": clock.applied,
                    "by": clock.by,
                    "steps": [[round(clock.t(mono), 3), round(step, 3)] for mono, step in clock.steps][:50],
                }
            )
    chosen = (agent.name for agent in record.agents for _, clock in agent.runs if clock.by == REFERENCE)
    return {
        "reference": "ground" if record.grounds else next(chosen, "each agent"),
        "missing": "" if record.grounds else NO_GROUND,
        "runs": rows,
    }


def _plots(agent: AgentRecord, begin: float, end: float) -> list[Json]:
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


def _thinned(plots: list[Json]) -> list[Json]:
    """At most MOST_POINTS in all: every second, third ... point of each where there are many."""
    step = 1 + sum(len(plot["points"]) for plot in plots) // MOST_POINTS
    return [{**plot, "points": plot["points"][::step]} for plot in plots]


def _ground_plots(record: Record, begin: float, end: float) -> list[Json]:
    found = []
    for ground, clock in record.grounds:
        for name, series in ground.series.items():
            points = [[round(clock.t(at), 2), value] for at, value in series.points() if begin <= clock.t(at) <= end]
            found.append({"agent": "ground", "name": name, "points": points})
    return [plot for plot in found if len(plot["points"]) > 1]


def _others(record: Record, begin: float, end: float) -> Json:
    names = {agent.id: agent.name for agent in record.agents}
    inside = [other for other in record.others if begin <= other.t <= end]
    rows = [
        {
            "t": round(other.t, 3),
            "agent": names[other.system],
            "system": other.system,
            "what": other.what,
            "text": other.text,
            "level": other.level,
            "by": other.by,
            "file": other.file,
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
    grounds = [{"run": ground.run, "version": ground.version, "lines": ground.lines} for ground, _ in record.grounds]
    return {
        "lines": record.part.lines,
        "bytes": record.part.bytes,
        "grounds": grounds,
        "problems": found,
        "more_problems": problems.more,
    }


def _clip(segments: list[levels.Segment], begin: float, end: float) -> list[levels.Segment]:
    cut = [(max(a, begin), min(b, end), level) for a, b, level in segments]
    return [one for one in cut if one[1] > one[0]][:5000]


def _rounded(spans: list[list[float]]) -> list[list[float]]:
    return [[round(span[0], 3), round(span[1], 3)] for span in spans][:2000]
