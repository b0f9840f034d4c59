"""One agent in the report: its times in each level, armed periods, gaps, actions."""

from __future__ import annotations

from typing import Any

from phm.review import check_rates, levels
from phm.review.record import AgentRecord, Record
from phm.review.spans import clipped, total, without

Json = dict[str, Any]


def row(
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


def _clip(segments: list[levels.Segment], begin: float, end: float) -> list[levels.Segment]:
    cut = [(max(a, begin), min(b, end), level) for a, b, level in segments]
    return [one for one in cut if one[1] > one[0]][:5000]


def _rounded(spans: list[list[float]]) -> list[list[float]]:
    return [[round(span[0], 3), round(span[1], 3)] for span in spans][:2000]
