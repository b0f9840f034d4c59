"""The faults of a record as rows: what, cause, consequences, evidence, detection, action, recovery, and the lines around."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

from phm.review.record import AgentRecord

Json = dict[str, Any]
BEFORE_S, AFTER_S = 5.0, 5.0
"""Lines so long before a fault opened and after it ended are shown with it."""
MOST_LINES = 40
MOST_STEPS = 60
KINDS = {"OK": "SUCCESS", "WARN": "WARNING", "ERROR": "FAILURE", "STALE": "STALE", "n/a": "BYPASS"}


def rows(agent: AgentRecord, begin: float, end: float) -> list[Json]:
    """Faults that were open at any time between begin and end."""
    running = agent.cover[-1][1] if agent.cover else 0.0
    times, lines = _lines(agent)
    steps: dict[str, list[Json]] = {}
    for t, mark in agent.marks:
        if mark.what == "action":
            step = {"t": round(t, 3), "action": mark.body["action"], "phase": mark.body["phase"], "text": mark.text}
            steps.setdefault(mark.body["fault"], []).append({**step, "attempt": mark.body["attempt"]})
    evidence = {change.fault: change.values for _, change in reversed(agent.changes) if change.values}
    found = []
    for fault in agent.faults:
        closed = fault["closed"]
        if fault["opened"] > end or (closed if closed is not None else running) < begin:
            continue
        found.append(_row(agent, fault, steps.get(fault["fault"], []), evidence.get(fault["fault"], {}), running))
        found[-1]["lines"] = _around(times, lines, fault["opened"], closed)
    return found


def _row(agent: AgentRecord, fault: Json, steps: list[Json], evidence: Json, running: float) -> Json:
    closed = fault["closed"]
    lasted = (closed if closed is not None else running) - fault["opened"]
    acted = next((step["t"] for step in steps if step["phase"] == "started"), None)
    return {
        "agent": agent.name,
        "fault": fault["fault"],
        "unit": fault["unit"],
        "check": fault["check"],
        "slot": fault["slot"],
        "layer": fault["layer"],
        "condition": fault["condition"],
        "summary": fault["summary"],
        "brief": fault["brief"],
        "target": fault["target"],
        "opened": round(fault["opened"], 3),
        "closed": None if closed is None else round(closed, 3),
        "lasted_s": round(lasted, 3),
        "outcome": fault["outcome"] if closed is not None else "open",
        "by": fault["by"],
        "consequences": fault["consequences"],
        "blocks": fault["blocks"],
        "suspects": fault["suspects"],
        "evidence": evidence,
        "acted_after_s": None if acted is None else round(acted - fault["opened"], 3),
        "steps": steps[:MOST_STEPS],
    }


def _lines(agent: AgentRecord) -> tuple[list[float], list[str]]:
    """Every line of the record that is kept, by time."""
    found = [
        (t, f"{KINDS.get(change.level, change.level)}: {change.unit}: {change.summary}") for t, change in agent.changes
    ]
    found += [
        (t, f"{mark.body.get('kind') or mark.what.upper()}: {_mark(mark.what, mark.text, mark.body)}")
        for t, mark in agent.marks
    ]
    found.sort(key=lambda one: one[0])
    return [t for t, _ in found], [text for _, text in found]


def _mark(what: str, text: str, body: Json) -> str:
    if what == "action":
        return text or f"{body['action']} {body['target']} {body['phase']}"
    return text


def _around(times: Sequence[float], lines: Sequence[str], opened: float, closed: float | None) -> list[Json]:
    """From a little before it opened to a little after it ended, or as many as fit."""
    first = bisect_left(times, opened - BEFORE_S)
    last = bisect_left(times, (closed if closed is not None else opened) + AFTER_S)
    return [
        {"t": round(times[place], 3), "text": lines[place]} for place in range(first, min(last, first + MOST_LINES))
    ]
