"""The merged record on one time axis: agents with their runs, and the ground. Times `t` are UTC seconds of the reference."""

from __future__ import annotations

import bisect
import itertools
import statistics
from array import array
from dataclasses import dataclass, field
from typing import Any

from phm.review import armed_periods, recordings
from phm.review.agent_record import AgentRecord
from phm.review.agent_run import Change, Run
from phm.review.boot_clocks import continue_by_autopilot
from phm.review.clocks import (
    RunClock,
    follow_machine,
    ground_clock,
    ordered_clock,
    own_clocks,
)
from phm.review.external_clocks import ExternalClock, align_external
from phm.review.external_entry import NO_TIME, ExternalEntry
from phm.review.ground_clocks import align
from phm.review.ground_part import GroundRun
from phm.review.heartbeat_clocks import align_by_heartbeats
from phm.review.part import Part
from phm.review.spans import Cover, Span, joined

QUIET_S = 30.0
"""At least this long nothing may be written before PHM counts as not running; and not less than 2.5 reports."""


@dataclass
class Record:
    """agents by name; grounds with their clocks; part: problems and counts of the files; others: in the order of time, with
    the clock of each of their files."""

    agents: list[AgentRecord]
    grounds: list[tuple[GroundRun, RunClock]]
    part: Part
    others: list[ExternalEntry] = field(default_factory=list)
    external_clocks: list[ExternalClock] = field(default_factory=list)
    recordings: dict[str, str] = field(default_factory=dict)
    """Name of the row, by path, of recordings of which the agent is not known."""

    @property
    def begin(self) -> float:
        return min((span[0] for span in self._spans()), default=0.0)

    @property
    def end(self) -> float:
        return max((span[1] for span in self._spans()), default=0.0)

    def _spans(self) -> list[Span]:
        own = [span for agent in self.agents for span in agent.cover]
        ground = [[clock.t(span[0]), clock.t(span[1])] for one, clock in self.grounds for span in one.cover.spans]
        return own or ground or [[other.t, other.t] for other in self.others]


def build(part: Part) -> Record:
    """Sort, remove what two files have twice, align, and put each agent's runs together."""
    clocks = ground_clock(part.grounds.values())
    grounds = [(ground, clocks[ground.run]) for ground in part.grounds.values()]
    agents: dict[tuple[str, int], AgentRecord] = {}
    runs = list(part.runs.values())
    for run in runs:
        _once(run)
    placed = list(zip(runs, own_clocks(runs), strict=True))
    align(placed, grounds)
    for run, clock in placed:
        agents.setdefault((run.agent, run.agent_id), AgentRecord(run.agent, run.agent_id)).runs.append((run, clock))
    align_by_heartbeats([one for agent in agents.values() for one in agent.runs], grounds)
    for agent in agents.values():
        follow_machine(agent.runs)
    names = [name for name, _ in agents]
    for (name, number), agent in agents.items():
        agent.name = name or f"agent {number}"
        if names.count(name) > 1:
            agent.name = f"{agent.name} (id {number})"
        _join(agent)
    for number in sorted(
        {agent for ground, _ in grounds for agent in _received(ground)} - {agent.id for agent in agents.values()}
    ):
        agents["", number] = AgentRecord(
            next((g.names[number] for g, _ in grounds if number in g.names), f"A{number:02d}"), number
        )
    owned, names_of = recordings.owned(part.others, list(agents.values()))
    moved, external_clocks = align_external(owned, [one for agent in agents.values() for one in agent.runs])
    for external_clock in external_clocks:
        if not external_clock.placed and external_clock.offset_s is None:
            part.problems.add(NO_TIME, external_clock.file)
    others = recordings.without_ours(moved, {agent.id for agent in agents.values() if agent.runs})
    for number in sorted({other.system for other in others if other.system} - {agent.id for agent in agents.values()}):
        agents["", number] = AgentRecord(f"vehicle {number}", number)
    for agent in agents.values():
        armed_periods.from_log_or_ground(agent, grounds)
        if not agent.armed:
            armed_periods.from_others(agent, [other for other in others if other.system == agent.id])
    every = sorted(agents.values(), key=lambda agent: (agent.id, agent.name))
    every += [AgentRecord(name, 0) for name in sorted(set(names_of.values()))]
    return Record(every, grounds, part, others, external_clocks, names_of)


def _received(ground: GroundRun) -> set[int]:
    return {agent for _, agent, _ in ground.levels} | {agent for _, agent, _, _ in ground.presence}


def _once(run: Run) -> None:
    """In the order of the monotonic clock, each number once."""
    run.clock = ordered_clock(run.clock)
    changes = {(change.seq, change.mono, change.unit): change for change in run.changes}
    run.changes = sorted(changes.values(), key=lambda change: (change.mono, change.seq))
    run.unlogged = _unlogged(run)
    marks = {(mark.seq, mark.mono): mark for mark in run.marks}
    run.marks = sorted(marks.values(), key=lambda mark: (mark.mono, mark.seq))
    run.reports = array("d", sorted(set(run.reports)))
    run.cover.tolerance = max(QUIET_S, 2.5 * _interval_s(run))
    run.cover.merge(Cover(0.0))
    run.numbers.merge(Cover(0.0))


def _unlogged(run: Run) -> list[Change]:
    """Those that are changes, now that all parts of the run are known."""
    found = {(change.seq, change.mono, change.unit): change for change in run.unlogged}
    levels = {unit: body["level"] for unit, body in run.units.items()}
    for change in run.levels():
        if levels.get(change.unit) == change.level:
            found.pop((change.seq, change.mono, change.unit), None)
        levels[change.unit] = change.level
    return list(found.values())


def _interval_s(run: Run) -> float:
    """The time between reports. Only the first line of a run has it: where that was rotated away, the median of its reports."""
    if run.interval_s or len(run.reports) < 2:
        return run.interval_s
    return statistics.median(after - before for before, after in itertools.pairwise(run.reports))


def _join(agent: AgentRecord) -> None:
    agent.runs.sort(key=_began)
    continue_by_autopilot(agent.runs)
    agent.runs.sort(key=_began)
    spans: list[Span] = []
    for run, clock in agent.runs:
        spans += [[clock.t(begin), clock.t(end)] for begin, end in run.cover.spans]
        agent.changes += [(clock.t(change.mono), change) for change in run.changes]
        agent.marks += [(clock.t(mark.mono), mark) for mark in run.marks]
        agent.reports += [clock.t(mono) for mono in run.reports]
        for name, fault in run.faults.items():
            agent.faults.append(_fault(name, fault, run, clock))
    agent.cover = joined(spans)
    agent.faults = _continued(agent.faults)
    _end_forgotten(agent)
    agent.reports = sorted(set(agent.reports))
    agent.changes.sort(key=lambda one: one[0])
    agent.marks.sort(key=lambda one: one[0])


def _began(one: tuple[Run, RunClock]) -> float:
    """When the run began; 0 without a line."""
    run, clock = one
    return clock.t(run.cover.spans[0][0]) if run.cover.spans else 0.0


def _fault(name: str, fault: dict[str, Any], run: Run, clock: RunClock) -> dict[str, Any]:
    opened, closed = fault["opened_at"], fault["closed_at"]
    begin = clock.t(opened if opened is not None else closed)
    check = run.units.get(fault["unit"], {}).get("check") or fault["unit"].partition("/")[0]
    return {
        **fault,
        "fault": name,
        "check": check,
        "opened": begin,
        "closed": None if closed is None else clock.t(closed),
    }


def _continued(faults: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A fault that stayed open over a restart of PHM keeps its id, and is one fault."""
    by_id: dict[str, dict[str, Any]] = {}
    for fault in sorted(faults, key=lambda one: float(one["opened"])):
        had = by_id.get(fault["fault"])
        if had is None:
            by_id[fault["fault"]] = fault
        elif had["closed"] is None:
            by_id[fault["fault"]] = {**fault, "opened": had["opened"]}
    return sorted(by_id.values(), key=lambda one: float(one["opened"]))


def _end_forgotten(agent: AgentRecord) -> None:
    """A fault whose end has no line. Its unit is OK later in its run: it had ended by then. A later run does not know it although its
    unit is OK: it ended at an unknown time, at the latest with its run."""
    last: dict[str, tuple[Run, str]] = {}
    ends: dict[str, tuple[str, float]] = {}
    recovered: dict[tuple[str, str], list[float]] = {}
    for run, clock in agent.runs:
        last.update({unit: (run, body["level"]) for unit, body in run.units.items()})
        for change in run.levels():
            last[change.unit] = (run, change.level)
            if change.level == "OK":
                recovered.setdefault((run.boot_id, change.unit), []).append(clock.t(change.mono))
        ends.update({fault: (run.boot_id, clock.t(run.cover.spans[-1][1])) for fault in run.faults if run.cover.spans})
    for fault in agent.faults:
        if fault["closed"] is not None or fault["unit"] not in last:
            continue
        run, level = last[fault["unit"]]
        boot, end = ends.get(fault["fault"], ("", fault["opened"]))
        times = recovered.get((boot, fault["unit"]), [])
        place = bisect.bisect_right(times, fault["opened"])
        if place < len(times):
            fault.update(closed=times[place], outcome="unknown")
        elif level == "OK" and fault["fault"] not in run.faults:
            fault.update(closed=max(fault["opened"], end), outcome="unknown")
