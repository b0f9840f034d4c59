"""One agent in the report: its times in each level, armed periods, gaps, actions."""

from __future__ import annotations

import itertools
from typing import Any

from phm.review import check_rates, levels, own_figures
from phm.review.agent_record import AgentRecord
from phm.review.armed_periods import ended_armed
from phm.review.omitted import OmittedCounts
from phm.review.record import Record
from phm.review.spans import Span, clipped, total, without

Json = dict[str, Any]
MOST_SEGMENTS, LEAST_SEGMENTS = 100_000, 5000
"""Of the levels of all agents together, but never less than the second number for one."""
MOST_UNITS, LEAST_UNIT_SEGMENTS = 40, 500
"""Units of one agent that are drawn, and segments that each may have at least."""
MOST_ACTIONS, MOST_SPANS, MOST_RUNS = 2000, 2000, 200
UNITS_CUT = "units in the timeline"
PHASES = ("started", "verified", "failed", "escalated")


def row(
    record: Record,
    agent: AgentRecord,
    units: dict[str, list[levels.Segment]],
    faults: list[Json],
    begin: float,
    end: float,
    omitted: OmittedCounts,
) -> Json:
    worst = levels.of_agent(units.values(), agent.cover) if agent.runs else levels.of_ground(record, agent.id)
    spent = levels.seconds(worst, begin, end)
    most = max(LEAST_SEGMENTS, MOST_SEGMENTS // max(1, len(record.agents)))
    segments, joined_s = levels.shortened(_clip(worst, begin, end), most)
    shown, units_joined_s = _shown_units(
        agent, units, begin, end, omitted, max(LEAST_UNIT_SEGMENTS, most // MOST_UNITS)
    )
    down, uptime = _down(agent, begin, end)
    armed = clipped(agent.armed, begin, end)
    lost, missing = _lost(agent)
    failing = _failing(agent, begin, end)
    if not agent.runs and segments and segments[-1][2] == "ERROR":
        failing = [{"unit": "", "summary": "", "brief": ""}]
    inside = [(run, clock) for run, clock in agent.runs if own_figures.overlaps(run, clock, begin, end)]
    runs = [
        {
            "boot_id": run.boot_id,
            "begin": round(clock.t(run.cover.spans[0][0]), 3),
            "end": round(clock.t(run.cover.spans[-1][1]), 3),
        }
        for run, clock in inside
    ]
    return {
        "agent": agent.name,
        "agent_id": agent.id,
        "logged": bool(agent.runs),
        "versions": sorted({run.version for run, _ in inside if run.version}),
        "runs": omitted.keep(agent.name, "runs of PHM", runs, MOST_RUNS),
        "faults": len(check_rates.opened(faults, round(begin, 3))),
        "error_s": round(spent.get("ERROR", 0.0), 3),
        "warn_s": round(spent.get("WARN", 0.0), 3),
        "unknown_s": round(spent.get("STALE", 0.0), 3),
        "armed_s": round(total(armed), 3),
        "uptime": uptime,
        "down": _spans(agent, "times in which PHM did not run", down, omitted),
        "armed": _spans(agent, "armed periods", armed, omitted),
        "link_gaps": _spans(agent, "link gaps", clipped(levels.gaps(record, agent.id), begin, end), omitted),
        "levels": _rounded(segments),
        "joined_s": round(joined_s, 2),
        "units": shown,
        "failing": failing,
        "units_joined_s": round(units_joined_s, 2),
        "actions": omitted.keep(agent.name, "actions in the timeline", _actions(agent, begin, end), MOST_ACTIONS),
        "lost_lines": lost,
        "missing_lines": missing,
        "left_out": sum(run.left_out for run, _ in agent.runs),
    }


def _failing(agent: AgentRecord, begin: float, end: float) -> list[Json]:
    """Units in ERROR at the end of the window, or where the log of the agent ends in it, with their last line about it."""
    said: dict[str, tuple[str, str, str]] = {}
    for run, clock in agent.runs:
        if not run.cover.spans or clock.t(run.cover.spans[-1][1]) < begin:
            continue
        known = {
            unit: (body["level"], body["summary"], "") for unit, body in run.units.items() if clock.t(body["at"]) <= end
        }
        changes = (change for change in run.levels() if clock.t(change.mono) <= end)
        known.update({change.unit: (change.level, change.summary, change.brief) for change in changes})
        said = known or said
    return [
        {"unit": unit, "summary": summary, "brief": brief}
        for unit, (level, summary, brief) in said.items()
        if level == "ERROR"
    ]


def _down(agent: AgentRecord, begin: float, end: float) -> tuple[list[Span], float | None]:
    """When PHM did not run, and the share of the time in which it ran while the computer was on; None: not known."""
    first = max(begin, agent.cover[0][0]) if agent.cover else begin
    # A log that ends while its autopilot is armed was not ended by anyone: PHM, or its computer, was lost.
    flying = agent.flying and bool(agent.armed) and agent.armed[-1][1] >= agent.end - 1.0
    last = end if flying else min(end, agent.end)
    if not agent.runs or last <= first:
        return [], None
    on = without([[first, last]], _off(agent))
    down = clipped(without([[first, last]], agent.cover), begin, end)
    return down, round(1 - total(without(on, agent.cover)) / total(on), 6) if on else None


def _off(agent: AgentRecord) -> list[Span]:
    """When its computer was off, or started: between runs of two starts of it. In flight it was not switched off on purpose."""
    found: list[Span] = []
    runs = [(run, clock) for run, clock in agent.runs if run.cover.spans]
    for (run, clock), (later, later_clock) in itertools.pairwise(runs):
        span = [clock.t(run.cover.spans[-1][1]), later_clock.t(later.cover.spans[0][0])]
        known = run.machine_boot and later.machine_boot and run.machine_boot != later.machine_boot
        if known and span[0] < span[1] and not ended_armed(run):
            found.append(span)
    return without(found, agent.cover)


def _lost(agent: AgentRecord) -> tuple[int, int]:
    """Lines that PHM said it could not write, and those that are missing besides."""
    lost = sum(mark.body["lines"] for _, mark in agent.marks if mark.what == "lost")
    # An event `lost` has the number of the last line that it counts; the others are a gap before it.
    explained = sum(max(0, mark.body["lines"] - 1) for _, mark in agent.marks if mark.what == "lost")
    gaps = sum(int(gap[1] - gap[0]) - 1 for run, _ in agent.runs for gap in run.numbers.gaps())
    return lost, max(0, gaps - explained)


def _actions(agent: AgentRecord, begin: float, end: float) -> list[list[Any]]:
    return [
        [round(t, 2), mark.body["action"], mark.body["phase"]]
        for t, mark in agent.marks
        if mark.what == "action" and begin <= t <= end and mark.body["phase"] in PHASES
    ]


def _shown_units(
    agent: AgentRecord,
    units: dict[str, list[levels.Segment]],
    begin: float,
    end: float,
    omitted: OmittedCounts,
    most: int,
) -> tuple[dict[str, list[list[Any]]], float]:
    """Units that were not always healthy, the worst first, and the seconds within which changes are joined."""
    spent = {unit: levels.seconds(segments, begin, end) for unit, segments in units.items()}
    bad = [unit for unit, by in spent.items() if any(by.get(level, 0.0) > 0.05 for level in ("ERROR", "WARN", "STALE"))]
    bad.sort(key=lambda unit: [-spent[unit].get(level, 0.0) for level in ("ERROR", "WARN", "STALE")])
    kept = omitted.keep(agent.name, UNITS_CUT, bad, MOST_UNITS)
    shown = {unit: levels.shortened(_clip(units[unit], begin, end), most) for unit in kept}
    return (
        {unit: _rounded(segments) for unit, (segments, _) in shown.items()},
        max((joined_s for _, joined_s in shown.values()), default=0.0),
    )


def _clip(segments: list[levels.Segment], begin: float, end: float) -> list[levels.Segment]:
    cut = [(max(a, begin), min(b, end), level) for a, b, level in segments]
    return [one for one in cut if one[1] > one[0]]


def _rounded(segments: list[levels.Segment]) -> list[list[Any]]:
    return [[round(a, 2), round(b, 2), level] for a, b, level in segments]


def _spans(agent: AgentRecord, what: str, spans: list[Span], omitted: OmittedCounts) -> list[list[float]]:
    kept = omitted.longest(agent.name, what, spans, MOST_SPANS)
    return [[round(span[0], 3), round(span[1], 3)] for span in kept]
