"""Describes a record in five sentences."""

from __future__ import annotations

import re
from collections import Counter
from typing import Any

from phm.review.check_rates import by_action, counted, opened, repair_times
from phm.wire.report import clock_text

Json = dict[str, Any]
ADVICE = re.compile(r"expected (?:(?!\. ).)*: ([a-z][^:]+)$")
"""What to do, at the end of a fault's summary: after the last colon, in the sentence with what was expected. Other colons are in what
was found, as an exit code's meaning or the last output of a health check."""

NO_AGENT = (
    "Faults are unknown: no agent is in the record.",
    "Whether a fault was open at the end is unknown.",
    "The worst agent and PHM's own uptime are unknown.",
    "Before the next flight, find out why the ground received no agent.",
)
"""A record of nothing must not read like a record of no fault."""


def build(document: Json) -> list[str]:
    """Duration and agents; faults; what is open; the worst agent and PHM itself; what to do before the next flight."""
    if not vehicles(document):
        return [_what(document), *NO_AGENT]
    return [_what(document), _faults(document), _open(document), _worst(document), _next(document)]


def vehicles(document: Json) -> list[Json]:
    """The rows of agents; a recording of which the agent is not known has a row, too."""
    return [row for row in document["agents"] if row["agent_id"] or row["logged"]]


def length(seconds: float | None) -> str:
    """``45 s``, ``12 min 30 s``, ``3 h 05 min``."""
    if seconds is None:
        return "an unknown time"
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.1f} s" if seconds < 10 else f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def times(document: Json) -> Json:
    """`begin`, `end` and `duration_s` of the flight, without the margin of its window; of the window if it is not a flight."""
    window: Json = document["window"]
    return next((flight for flight in document["flights"] if flight["number"] == window["flight"]), window)


def _what(document: Json) -> str:
    window, agents, lasted = document["window"], vehicles(document), times(document)
    which = f"Flight {window['flight']}" if window["flight"] else "The record"
    flown = "" if window["flight"] else f" and {_count(len(document['flights']), 'flight')}"
    begin, end = clock_text(lasted["begin"])[:19], clock_text(lasted["end"])[:19]
    when = f"from {begin} to {end[11:] if end[:10] == begin[:10] else end} UTC"
    return f"{which} lasted {length(lasted['duration_s'])}, {when}, with {_count(len(agents), 'agent')}{flown}."


def _faults(document: Json) -> str:
    faults = opened(document["faults"], document["window"]["begin"])
    if not faults:
        return "No fault opened." if counted(document["faults"]) else "There was no fault."
    actions = sum(by_action(fault) for fault in faults)
    resolved = sum(fault["outcome"] == "resolved" for fault in faults)
    times = repair_times(faults)
    mean = f", after {length(sum(times) / len(times))} on average" if times else ""
    head = f"There {'was' if len(faults) == 1 else 'were'} {_count(len(faults), 'fault')}"
    return f"{head}: {actions} ended by an action of PHM and {resolved - actions} otherwise{mean}."


def _open(document: Json) -> str:
    faults = counted(document["faults"])
    left = [fault for fault in faults if fault["outcome"] == "open"]
    given_up = sum(fault["outcome"] == "escalated" for fault in faults)
    named = {(fault["agent"], fault["unit"]) for fault in faults if fault["outcome"] in ("open", "escalated")}
    others = sum(bool(row["unit"]) and (row["agent"], row["unit"]) not in named for row in _failing(document))
    also = f"; {_count(others, 'unit')} without one {'was' if others == 1 else 'were'} in ERROR" if others else ""
    if not left and not given_up:
        return f"No fault was open at the end, and PHM gave up on none{also}."
    names = ", ".join(f"{fault['agent']} {fault['brief'] or fault['unit']}" for fault in left[:3])
    more = f" and {len(left) - 3} more" if len(left) > 3 else ""
    opened = f"{_count(len(left), 'fault')} {'was' if len(left) == 1 else 'were'} open at the end" + (
        f" ({names}{more})" if left else ""
    )
    return f"{opened}, and PHM gave up on {given_up}{also}."


def _worst(document: Json) -> str:
    uptime = document["phm"]["uptime"]
    ran = "PHM's own uptime is unknown" if uptime is None else f"PHM ran {100 * uptime:.2f} % of the time"
    bad = [agent for agent in document["agents"] if agent["error_s"] > 0]
    if not bad:
        return f"No agent was in ERROR; {ran}."
    worst = max(bad, key=lambda agent: (agent["error_s"], agent["faults"]))
    return f"{worst['agent']} was worst, with {_count(worst['faults'], 'fault')} and {length(worst['error_s'])} in ERROR; {ran}."


def _next(document: Json) -> str:
    faults = counted(document["faults"])
    left = [
        fault
        for fault in faults
        if fault["outcome"] == "open" or (fault["outcome"] == "escalated" and fault["ok_again"] is None)
    ]
    left = left or _failing(document)[:1]
    if left:
        first = left[-1]
        if not first["unit"]:
            return f"Before the next flight, look at {first['agent']}: it was in ERROR when it was last received."
        advice = ADVICE.search(first["summary"])
        look = ": ".join(filter(None, (f"look at {first['unit']}", first["brief"])))
        what = advice.group(1).rstrip(".") if advice else look
        return f"Before the next flight, on {first['agent']} ({first['unit']}): {what}."
    repeated = Counter((fault["agent"], fault["unit"]) for fault in faults).most_common(1)
    if repeated and repeated[0][1] > 1:
        (agent, unit), count = repeated[0]
        return f"Before the next flight, find out why {unit} of {agent} failed {count} times; each time it recovered."
    lost = sum(row["lost_lines"] + row["missing_lines"] for row in [*document["agents"], *document["files"]["grounds"]])
    if lost:
        return f"Before the next flight, check the disks: {lost} lines of the logs are missing."
    return "Nothing in the record has to be done before the next flight."


def _failing(document: Json) -> list[Json]:
    """The units that were in ERROR at the end, with or without a fault; one without a name: of an agent without a log."""
    return [{"agent": agent["agent"], **row} for agent in document["agents"] for row in agent["failing"]]


def _count(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"
