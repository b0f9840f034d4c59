"""What the report says of PHM itself in its window: uptime, cost, reports, radio bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phm.review.agent_record import AgentRecord
from phm.review.agent_run import Run
from phm.review.clocks import RunClock
from phm.review.record import Record

Json = dict[str, Any]
EDGE_S = 0.001
"""UTC and monotonic time differ by rounding: a line at the edge of the window is in it."""
RELOADED = "configuration reloaded: "
"""Beginning of the note about a reload (`phm.runtime.reloader`)."""
Runs = Sequence[tuple[Run, float, float]]
"""Runs, each with the window on its own clock."""


def build(record: Record, uptimes: dict[str, float], begin: float, end: float, *, whole: bool) -> Json:
    """uptimes by agent, in the window. whole: the window is the whole record; of a part of it the log cannot say everything."""
    agents = [
        _agent(record, agent, uptimes, begin, end, whole=whole)
        for agent in record.agents
        if any(overlaps(run, clock, begin, end) for run, clock in agent.runs)
    ]
    return {"uptime": round(sum(uptimes.values()) / len(uptimes), 6) if uptimes else None, "agents": agents}


def _agent(
    record: Record, agent: AgentRecord, uptimes: dict[str, float], begin: float, end: float, *, whole: bool
) -> Json:
    runs = [
        (run, begin - clock.shift - EDGE_S, end - clock.shift + EDGE_S)
        for run, clock in agent.runs
        if overlaps(run, clock, begin, end)
    ]
    took = [
        seconds
        for run, first, last in runs
        for mono, seconds in dict(zip(run.took_at, run.took_s, strict=True)).items()
        if first <= mono <= last
    ]
    reports = sum(first <= mono <= last for run, first, last in runs for mono in run.reports)
    costs = [cost for run, first, last in runs if (cost := run.cost.between(first, last)) is not None]
    seconds = sum(cost[0] for cost in costs)
    reloads = sum(map(_by_reload, (run for run, _, _ in runs[1:])))
    return {
        "agent": agent.name,
        "uptime": uptimes.get(agent.name),
        "restarts": len(runs) - 1 - reloads,
        "reloads": reloads,
        "cpu_percent": round(100 * sum(cost[1] for cost in costs) / seconds, 2) if seconds > 0 else None,
        "memory_bytes": max(run.cost.memory(first, last) for run, first, last in runs) or None,
        "sent_bytes": round(sum(cost[2] for cost in costs)) if costs else None,
        "reports": reports,
        "report_mean_s": round(sum(took) / len(took), 4) if took else None,
        "report_longest_s": round(max(took), 4) if took else None,
        "check_mean_ms": _checks(runs) if whole else None,
        "text_bytes": _text_bytes(record, agent.id, begin, end, whole=whole),
    }


def _by_reload(run: Run) -> bool:
    """Whether it began with a reload of the configuration: its log says what has changed. Without changes no run begins."""
    said = [mark.text for mark in run.marks if mark.what == "note" and mark.body["kind"] == "PHM"]
    return any(text.startswith(RELOADED) and not text.startswith(f"{RELOADED}no changes") for text in said)


def overlaps(run: Run, clock: RunClock, begin: float, end: float) -> bool:
    """Whether the run has lines of the window, or before and after it."""
    spans = run.cover.spans
    return bool(spans) and clock.t(spans[0][0]) <= end and clock.t(spans[-1][1]) >= begin


def _checks(runs: Runs) -> dict[str, float]:
    """Mean of each check. The log's sums are of whole runs."""
    checks: dict[str, list[float]] = {}
    for run, _, _ in runs:
        for check, (count, spent_ms, _) in run.check_ms.items():
            had = checks.setdefault(check, [0.0, 0.0])
            had[0], had[1] = had[0] + count, had[1] + spent_ms
    return {check: round(spent_ms / count, 2) for check, (count, spent_ms) in sorted(checks.items()) if count}


def _text_bytes(record: Record, agent: int, begin: float, end: float, *, whole: bool) -> int | None:
    """Bytes of text that the ground received; None: no record of the ground, or it had too many texts to know their times."""
    if not record.grounds or (not whole and any(ground.untimed for ground, _ in record.grounds)):
        return None
    if whole:
        return sum(ground.bytes_of.get(agent, 0) for ground, _ in record.grounds)
    return sum(
        size
        for ground, clock in record.grounds
        for mono, which, size in ground.text_bytes
        if which == agent and begin <= clock.t(mono) <= end
    )
