"""Table 2 of the PHM paper for any logs with INJECT events: notes that begin with `INJECT`, by `phm note "INJECT ..."`.

The definitions are those of docs/development/campaign.md, as far as a log alone allows: what ended a fault is what PHM's record
says, without a second observer.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Any

from phm.review.agent_record import AgentRecord
from phm.review.check_rates import by_action, counted

Json = dict[str, Any]
INJECT = re.compile(r"inject\b", re.IGNORECASE)
LATE_S, TOGETHER = 30.0, 8
"""Of injections that follow each other, a fault that a note names may open this long after the next note; and this many notes before and after
it are looked at."""
STEPS = ("advised", "refused", "done", "failed", "verified", "escalated")
"""Phases with which a step of PHM's response to a fault is complete."""
PAPER = {
    "response_s": 14.82,
    "detection_s": 5.2,
    "self_resolved": 0.166,
    "phm_uptime": 0.9677,
    "agents": 8,
    "interval_s": 20.0,
}


def build(
    agents: Sequence[AgentRecord], faults: Sequence[Json], uptime: Mapping[str, float], begin: float, end: float
) -> Json | None:
    """Table 2 of the record; None if nothing was injected."""
    injected: list[Json] = []
    for agent in agents:
        moments = [
            (t, mark.text)
            for t, mark in agent.marks
            if mark.what == "note" and INJECT.match(mark.text) and begin <= t <= end
        ]
        mine = sorted(
            (fault for fault in counted(faults) if fault["agent"] == agent.name),
            key=_opened,
        )
        for place, (t, text) in enumerate(moments):
            injected.append(_injection(agent, t, text, _caused(mine, moments, place)))
    if not injected:
        return None
    known = [one for one in injected if one["fault"] is not None]
    return {
        "paper": PAPER,
        "agents": len(agents),
        "interval_s": sorted({run.interval_s for agent in agents for run, _ in agent.runs if run.interval_s}),
        "injected": len(injected),
        "detected": len(known),
        "first_alarm_s": _mean([one["alarm_s"] for one in known]),
        "detection_s": _mean([one["logged_s"] for one in known]),
        "response_s": _mean([one["published_s"] for one in known]),
        "self_resolved": sum(one["by_action"] for one in known) / len(injected),
        "phm_uptime": _mean(list(uptime.values())),
        "injections": injected,
    }


def _caused(faults: Sequence[Json], moments: Sequence[tuple[float, str]], place: int) -> Json | None:
    """The fault of one of an agent's injections: the first that its note claims, or else the first before the next injection that no
    note before claims.
    """
    t, until = moments[place][0], _next(moments, place)
    first, last = (bisect_left(faults, at, key=_opened) for at in (t, until + LATE_S))
    near, before = faults[first:last], range(max(0, place - TOGETHER), place)
    for fault in near:
        if _claims(moments, place, fault):
            return fault
    for fault in near:
        if fault["opened"] < until and not any(_claims(moments, each, fault) for each in before):
            return fault
    return None


def _claims(moments: Sequence[tuple[float, str]], place: int, fault: Json) -> bool:
    """Whether this note is the last before the fault that names its subject, and the next note is not long before it."""
    (t, text), opened = moments[place], fault["opened"]
    if not t <= opened < _next(moments, place) + LATE_S or not _names(text, _subject(fault)):
        return False
    later = moments[place + 1 : place + 1 + TOGETHER]
    return not any(at <= opened and _names(other, _subject(fault)) for at, other in later)


def _next(moments: Sequence[tuple[float, str]], place: int) -> float:
    return moments[place + 1][0] if place + 1 < len(moments) else math.inf


def _opened(fault: Json) -> float:
    return float(fault["opened"])


def _subject(fault: Json) -> str:
    return str(fault["unit"].partition("/")[2] or fault["unit"])


def _names(text: str, subject: str) -> bool:
    """Whether the text has this name: node_1 is not in node_10."""
    return re.search(rf"(?<![\w.-]){re.escape(subject)}(?![\w-])", text) is not None


def _injection(agent: AgentRecord, t: float, text: str, fault: Json | None) -> Json:
    row: Json = {"agent": agent.name, "t": round(t, 3), "text": text, "fault": None, "by_action": False}
    if fault is None:
        return {**row, "alarm_s": None, "logged_s": None, "published_s": None}
    steps = [step["t"] for step in fault["steps"] if step["phase"] in STEPS]
    place = bisect_left(agent.reports, fault["opened"])
    published = agent.reports[place] - t if place < len(agent.reports) else None
    return {
        **row,
        "fault": fault["fault"],
        "by_action": by_action(fault),
        "alarm_s": round(fault["opened"] - t, 3),
        "logged_s": round(max([fault["opened"], *steps]) - t, 3),
        "published_s": None if published is None else round(published, 3),
    }


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(sum(known) / len(known), 4) if known else None
