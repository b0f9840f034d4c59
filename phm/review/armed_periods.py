"""When the autopilot of an agent was armed: by its own log, by the ground, or by other records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from phm.review.agent_record import AgentRecord
from phm.review.agent_run import Run
from phm.review.clocks import RunClock
from phm.review.external_entry import ExternalEntry
from phm.review.ground_part import GroundRun
from phm.review.spans import Span, joined


class _ArmedReport(NamedTuple):
    """What a run says of its autopilot. mono: on its clock; continued: armed since before this run."""

    mono: float
    armed: bool
    duration_s: Any
    continued: bool


def from_log_or_ground(agent: AgentRecord, grounds: list[tuple[GroundRun, RunClock]]) -> None:
    """From the flights in its log, else from what its check of the autopilot says; from the ground where it has no log."""
    edges = _logged(agent, _by_flights) or _logged(agent, _by_autopilot)
    agent.armed, agent.flying = _spans(edges, agent.end), _flying(edges)
    if not agent.runs:
        agent.armed = _armed_by_ground(agent.id, grounds)


def from_others(agent: AgentRecord, others: list[ExternalEntry]) -> None:
    """From other records, where neither its log nor the ground says it. In each an armed period ends at the latest with its last entry:
    the next one may be of another day, and begins with a change, which does not continue anything."""
    edges = [(other.t, other.began, None) for other in others if other.what == "arming"]
    spans: list[Span] = []
    for file in {other.file for other in others}:
        mine = [other for other in others if other.file == file]
        spans += _spans([(one.t, one.began, None) for one in mine if one.what == "arming"], max(one.t for one in mine))
    agent.armed, agent.flying = joined(spans), _flying(edges)


def ended_armed(run: Run) -> bool:
    """Whether the autopilot was armed at the end of the run, as far as its log says."""
    said = _by_flights(run) or _by_autopilot(run)
    return bool(said) and said[-1].armed


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


def _logged(agent: AgentRecord, say: Callable[[Run], list[_ArmedReport]]) -> list[tuple[float, bool, Any]]:
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


def _by_flights(run: Run) -> list[_ArmedReport]:
    marks = [(mark.mono, mark.body) for mark in run.marks if mark.what == "flight"]
    return [
        _ArmedReport(mono, bool(body["began"]), body["duration_s"], bool(body["began"] and body["continued"]))
        for mono, body in marks
    ]


def _by_autopilot(run: Run) -> list[_ArmedReport]:
    """Its first line of the check has a state, not a change: an autopilot that is armed there was armed before."""
    return [_ArmedReport(mono, armed, None, armed and place == 0) for place, (mono, armed) in enumerate(run.armed)]


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
