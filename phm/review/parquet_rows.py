"""The rows of a dataset of many flights: what one run of PHM says, whatever else is in the record."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from phm.review import levels
from phm.review.agent_record import AgentRecord
from phm.review.agent_run import Run
from phm.review.check_rates import ROUNDED_S
from phm.review.clocks import RunClock
from phm.review.spans import Span, clipped, total

Json = dict[str, Any]
Rows = list[tuple[Any, ...]]


def by_run(agent: AgentRecord) -> Iterator[tuple[Run, dict[str, Rows]]]:
    """The rows of each table, by run; columns as in `phm.review.parquet.SCHEMAS`. A fault is a row of the first run that has it."""
    first: dict[str, int] = {}
    for place, (run, _) in enumerate(agent.runs):
        for name in run.faults:
            first.setdefault(name, place)
    faults: dict[int, list[Json]] = {}
    for fault in agent.faults:
        faults.setdefault(first[fault["fault"]], []).append(fault)
    for place, (run, clock) in enumerate(agent.runs):
        spans = [[clock.t(begin), clock.t(end)] for begin, end in run.cover.spans]
        if spans:
            yield run, _tables(agent, run, clock, spans, faults.get(place, []))


def _tables(agent: AgentRecord, run: Run, clock: RunClock, spans: list[Span], faults: list[Json]) -> dict[str, Rows]:
    ran_s, armed_s = total(spans), sum(total(clipped(agent.armed, *span)) for span in spans)
    alone = AgentRecord(agent.name, agent.id, [(run, clock)], spans)
    return {
        "runs": [(run.boot_id, run.version, spans[0][0], spans[-1][1], armed_s, ran_s)],
        "checks": [(check, ran_s, armed_s) for check in sorted({body["check"] for body in run.units.values()})],
        "faults": [_fault(agent, fault, spans[0][0]) for fault in faults],
        "actions": [
            (
                clock.t(mark.mono),
                mark.body["fault"],
                mark.body["unit"],
                mark.body["action"],
                mark.body["phase"],
                mark.body["attempt"],
                mark.body["target"],
                mark.text,
            )
            for mark in run.marks
            if mark.what == "action"
        ],
        "levels": [(unit, *segment) for unit, found in levels.of_units(alone).items() for segment in found],
        "metrics": [(clock.t(at), name, value) for name, series in run.series.items() for at, value in series.points()],
    }


def _fault(agent: AgentRecord, fault: Json, begin: float) -> tuple[Any, ...]:
    """begin: of the run."""
    lasted = (fault["closed"] if fault["closed"] is not None else agent.end) - fault["opened"]
    armed = any(first <= fault["opened"] <= last for first, last in agent.armed)
    continued = fault["opened"] < begin - ROUNDED_S
    keys = ("fault", "unit", "check", "slot", "layer", "condition", "target", "opened", "closed")
    outcome = fault["outcome"] if fault["closed"] is not None else "open"
    return (*(fault[key] for key in keys), lasted, outcome, fault["by"], armed, continued, fault["summary"])
