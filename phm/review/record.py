"""The merged record on one time axis: agents with their runs, and the ground. Times `t` are UTC seconds of the reference."""

from __future__ import annotations

import bisect
import itertools
import statistics
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from phm.review import recordings
from phm.review.agent_run import Change, Run, RunMark
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


class _Said(NamedTuple):
    """What a run says of its autopilot. mono: on its clock; continued: armed since before this run."""

    mono: float
    armed: bool
    duration_s: Any
    continued: bool


@dataclass
class AgentRecord:
    """One agent; the id 0: a recording of which the agent is not known. cover: when its PHM wrote;
    armed: when its autopilot was, as far as known; flying: it was at the end."""

    name: str
    id: int
    runs: list[tuple[Run, RunClock]] = field(default_factory=list)
    cover: list[Span] = field(default_factory=list)
    armed: list[Span] = field(default_factory=list)
    flying: bool = False
    changes: list[tuple[float, Change]] = field(default_factory=list)
    marks: list[tuple[float, RunMark]] = field(default_factory=list)
    faults: list[dict[str, Any]] = field(default_factory=list)
    reports: list[float] = field(default_factory=list)

    @property
    def end(self) -> float:
        return self.cover[-1][1] if self.cover else 0.0

    @property
    def vehicle(self) -> bool:
        """Whether the agent is a vehicle; False: it is only a recording."""
        return bool(self.id or self.runs)


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
        _armed(agent, grounds)
        if not agent.armed:
            _armed_by_others(agent, [other for other in others if other.system == agent.id])
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
    agent.runs.sort(key=lambda one: one[1].t(one[0].cover.spans[0][0]) if one[0].cover.spans else 0.0)
    continue_by_autopilot(agent.runs)
    agent.runs.sort(key=lambda one: one[1].t(one[0].cover.spans[0][0]) if one[0].cover.spans else 0.0)
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


def _armed(agent: AgentRecord, grounds: list[tuple[GroundRun, RunClock]]) -> None:
    """From the flights in its log, else from what its check of the autopilot says; from the ground where it has no log."""
    edges = _logged(agent, _by_flights) or _logged(agent, _by_autopilot)
    agent.armed, agent.flying = _spans(edges, agent.end), _flying(edges)
    if not agent.runs:
        agent.armed = _armed_by_ground(agent.id, grounds)


def _armed_by_ground(system: int, grounds: list[tuple[GroundRun, RunClock]]) -> list[Span]:
    """A period ends with the last heartbeat before the autopilot was lost, or with the run of the ground, unless the next heartbeat
    that was received is armed, too, and no other ground received a disarming in between."""
    spans: list[Span] = []
    broken = False  # the last one ended without a disarming
    off = [clock.t(mono) for ground, clock in grounds for mono, which, on in ground.armed if which == system and not on]
    for ground, clock in sorted(
        grounds, key=lambda one: one[1].t(one[0].cover.spans[0][0]) if one[0].cover.spans else 0.0
    ):
        said: list[tuple[float, bool | None, float]] = [
            (mono, on, 0.0) for mono, which, on in ground.armed if which == system
        ]
        said += [(mono, None, age_s) for mono, which, age_s in ground.silent if which == system]
        since: float | None = None
        for mono, armed, age_s in sorted(said, key=lambda one: one[0]):
            t = clock.t(mono - age_s)
            if armed and since is None:
                goes_on = broken and spans[-1][1] <= t and not any(spans[-1][1] < other < t for other in off)
                since = spans.pop()[0] if goes_on else t
            elif not armed and since is not None:
                spans.append([since, max(since, t)])
                since = None
                broken = armed is None
            elif armed is False:
                broken = False
        if since is not None:
            spans.append([since, clock.t(ground.cover.spans[-1][1])])
            broken = True
    return [span for span in joined(spans) if span[0] < span[1]]


def _logged(agent: AgentRecord, say: Callable[[Run], list[_Said]]) -> list[tuple[float, bool, Any]]:
    """What its runs say. If a run ends armed and the next one does not continue that, it was armed until the last line of the run: the
    next one may begin days after a loss of power."""
    runs = [(run, clock, said) for run, clock in agent.runs if (said := say(run))]
    edges: list[tuple[float, bool, Any]] = []
    for place, (run, clock, said) in enumerate(runs):
        edges += [(clock.t(one.mono), one.armed, one.duration_s) for one in said]
        later = runs[place + 1][2] if place + 1 < len(runs) else []
        # Without any later run it is not known when it was disarmed; a later one that says nothing does not continue it.
        goes_on = later[0].continued if later else run is agent.runs[-1][0]
        if said[-1].armed and not goes_on and run.cover.spans:
            edges.append((clock.t(run.cover.spans[-1][1]), False, None))
    return edges


def ended_armed(run: Run) -> bool:
    """Whether the autopilot was armed at the end of the run, as far as its log says."""
    said = _by_flights(run) or _by_autopilot(run)
    return bool(said) and said[-1].armed


def _by_flights(run: Run) -> list[_Said]:
    marks = [(mark.mono, mark.body) for mark in run.marks if mark.what == "flight"]
    return [
        _Said(mono, bool(body["began"]), body["duration_s"], bool(body["began"] and body["continued"]))
        for mono, body in marks
    ]


def _by_autopilot(run: Run) -> list[_Said]:
    """Its first line of the check has a state, not a change: an autopilot that is armed there was armed before."""
    return [_Said(mono, armed, None, armed and place == 0) for place, (mono, armed) in enumerate(run.armed)]


def _armed_by_others(agent: AgentRecord, others: list[ExternalEntry]) -> None:
    """From other records, where neither its log nor the ground says it. In each an armed period ends at the latest with its last entry:
    the next one may be of another day, and begins with a change, which does not continue anything."""
    edges = [(other.t, other.began, None) for other in others if other.what == "arming"]
    spans: list[Span] = []
    for file in {other.file for other in others}:
        mine = [other for other in others if other.file == file]
        spans += _spans([(one.t, one.began, None) for one in mine if one.what == "arming"], max(one.t for one in mine))
    agent.armed, agent.flying = joined(spans), _flying(edges)


def _flying(edges: Sequence[tuple[float, bool, Any]]) -> bool:
    """Whether the last of these changes is an arming."""
    return bool(edges) and max(edges, key=lambda edge: edge[0])[1]


def _spans(edges: Sequence[tuple[float, bool, Any]], end: float) -> list[Span]:
    """(t, armed or disarmed, for how long it was armed if that is known) to armed periods; one that goes on ends at `end`. One of no
    length is left out: it would be a flight without agents."""
    spans: list[Span] = []
    since: float | None = None
    for t, began, duration_s in sorted(edges, key=lambda edge: edge[0]):
        if began:
            since = t if since is None else since
        elif since is not None or duration_s:
            spans.append([since if since is not None else t - float(duration_s or 0.0), t])
            since = None
    if since is not None and end > since:
        spans.append([since, end])
    return [span for span in joined(spans) if span[0] < span[1]]
