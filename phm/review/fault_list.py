"""The faults of a record as rows: what, cause, consequences, evidence, detection, action, recovery, and the lines around."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Any, NamedTuple

from phm.review.agent_record import AgentRecord
from phm.review.omitted import OmittedCounts

Json = dict[str, Any]
BEFORE_S, AFTER_S = 5.0, 5.0
"""Lines this long before a fault opened and after it ended are shown with it."""
HALF = 20
"""Lines around the opening, and around the end, where there are more than both together."""
MOST_STEPS = 60
ENDS = {"resolved": "RESOLVED", "escalated": "ESCALATED", "reattributed": "STALE"}
LATER = ("resolved", "escalated")
"""A fault that had such an end after the window was open at the end of the window."""
KINDS = {"OK": "SUCCESS", "WARN": "WARNING", "ERROR": "FAILURE", "STALE": "STALE", "n/a": "BYPASS"}


class _Lines(NamedTuple):
    """All lines of an agent by time. edges: place of the line that opened (False) or ended (True) a fault, by its id."""

    times: list[float]
    texts: list[str]
    edges: dict[tuple[str, bool], int]


def rows(agent: AgentRecord, begin: float, end: float, omitted: OmittedCounts) -> list[Json]:
    """Faults that were open at any time between begin and end, or given up and their unit not OK again.

    `ok_again`: when that was, of one that was given up; None: not until `end`.
    """
    running = agent.cover[-1][1] if agent.cover else 0.0
    lines = _lines(agent)
    steps: dict[str, list[Json]] = {}
    for t, mark in agent.marks:
        if mark.what == "action":
            step = {"t": round(t, 3), "action": mark.body["action"], "phase": mark.body["phase"], "text": mark.text}
            steps.setdefault(mark.body["fault"], []).append({**step, "attempt": mark.body["attempt"]})
    evidence = {change.fault: change.values for _, change in reversed(agent.changes) if change.values}
    recovered = _recovered(agent)
    found = []
    for fault in agent.faults:
        closed, again = fault["closed"], None
        last = closed if closed is not None else running
        if closed is not None and fault["outcome"] == "escalated":
            times = recovered.get(fault["unit"], [])
            again = next(iter(times[bisect_right(times, closed) :]), None)
            last = again if again is not None else max(closed, running)
        if fault["opened"] > end or last < begin:
            continue
        done = steps.get(fault["fault"], [])
        row = _row(agent, fault, done, evidence.get(fault["fault"], {}), running)
        if closed is not None and closed > end and fault["outcome"] in LATER:
            row.update(closed=None, outcome="open", by="")
        kept = omitted.keep(agent.name, "actions of a fault", done, MOST_STEPS)
        row["ok_again"] = None if again is None or again > end else round(again, 3)
        found.append({**row, "steps": kept, "lines": _around(lines, fault)})
    return found


def _recovered(agent: AgentRecord) -> dict[str, list[float]]:
    """When lines said that a unit is OK, by unit."""
    found: dict[str, list[float]] = {}
    for run, clock in agent.runs:
        first = [(body["at"], unit, body["level"]) for unit, body in run.units.items()]
        for mono, unit, level in [*first, *((each.mono, each.unit, each.level) for each in run.levels())]:
            if level == "OK":
                found.setdefault(unit, []).append(clock.t(mono))
    return {unit: sorted(times) for unit, times in found.items()}


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
    }


def _lines(agent: AgentRecord) -> _Lines:
    """Every line of the record that is kept. At one time openings are first and ends last."""
    edges: list[tuple[float, int, str, tuple[str, bool] | None]] = []
    opened: set[tuple[str, str]] = set()
    for fault in agent.faults:
        name, text = str(fault["fault"]), f"FAILURE: {fault['unit']}: {fault['summary']}"
        if fault["opened_at"] is not None:
            edges.append((fault["opened"], 0, text, (name, False)))
            opened.add((name, text))
        if fault["closed"] is not None and fault["outcome"] in ENDS:
            edges.append((fault["closed"], 2, f"{ENDS[fault['outcome']]}: {_end(fault)}", (name, True)))
    found = list(edges)
    for t, change in agent.changes:
        text = f"{KINDS.get(change.level, change.level)}: {change.unit}: {change.summary}"
        if (change.fault, text) in opened:  # the transition that opened the fault says the same
            opened.remove((change.fault, text))
        else:
            found.append((t, 1, text, None))
    found += [
        (t, 1, f"{mark.body.get('kind') or mark.what.upper()}: {_mark(mark.what, mark.text, mark.body)}", None)
        for t, mark in agent.marks
    ]
    found.sort(key=lambda one: one[:2])
    places = {edge: place for place, (*_, edge) in enumerate(found) if edge is not None}
    return _Lines([t for t, *_ in found], [text for _, _, text, _ in found], places)


def _end(fault: Json) -> str:
    ways = {"resolved": f"resolved by {fault['by'] or 'itself'}", "escalated": "PHM has given up"}
    way = ways.get(fault["outcome"], f"follows from {fault['by']}")
    return f"{fault['unit']}: {way} after {fault['closed'] - fault['opened']:.1f} s"


def _mark(what: str, text: str, body: Json) -> str:
    if what == "action":
        return text or f"{body['action']} {body['target']} {body['phase']}"
    return text


def _around(lines: _Lines, fault: Json) -> list[Json]:
    """From a little before it opened to a little after it ended; of many lines those around its opening and its end."""
    closed = fault["closed"] if fault["closed"] is not None else fault["opened"]
    first = bisect_left(lines.times, fault["opened"] - BEFORE_S)
    last = bisect_left(lines.times, closed + AFTER_S)
    if last - first <= 2 * HALF:
        return _shown(lines, first, last)
    name = str(fault["fault"])
    opening = lines.edges.get((name, False), bisect_left(lines.times, fault["opened"]))
    ending = lines.edges.get((name, True), last - 1)
    head = max(first, min(opening, last - 1) - HALF // 2)
    tail = max(head + HALF, min(last, ending + HALF // 2) - HALF)
    found = _left_out(lines, first, head) + _shown(lines, head, min(last, head + HALF))
    found += _left_out(lines, head + HALF, tail) + _shown(lines, tail, min(last, tail + HALF))
    return found + _left_out(lines, tail + HALF, last)


def _shown(lines: _Lines, first: int, last: int) -> list[Json]:
    return [{"t": round(lines.times[place], 3), "text": lines.texts[place]} for place in range(first, last)]


def _left_out(lines: _Lines, first: int, last: int) -> list[Json]:
    count = last - first
    said = f"... {count} line{'' if count == 1 else 's'}"
    return [{"t": round(lines.times[first], 3), "text": said}] if count > 0 else []
