"""The clocks of agents by the record of the ground.

An agent and the ground observe two things at nearly the same time: the autopilot's heartbeat that says armed or disarmed for the
first time, and a line about a change, which the ground receives within a second. Runs of one start of the machine have one
monotonic clock, so they are placed together, by what all of them have.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from phm.core.model import Level, Slot
from phm.review.agent_run import Run
from phm.review.clocks import RunClock, machine
from phm.review.events import WORDS
from phm.review.ground_part import GroundRun
from phm.review.spans import Span, both, joined, total
from phm.review.votes import (
    NEAR_S,
    SAME_S,
    WINDOW_S,
    Agreed,
    Key,
    Weight,
    candidate,
    compared,
    too_little,
    weigh,
    within,
)
from phm.wire import status_line

NOTHING = "its own clock: the ground received no line about a change and no arming that is in the log"
SEVERAL = "its own clock: the lines and armings that the ground also received fit several offsets"
BY = "lines and armings that the ground also received"
TAKEN = "but another run of this agent is there"
ARMED = "armed"
SLOTS = frozenset(each.value for each in Slot)
Observed = dict[Key, list[float]]


@dataclass
class _Received:
    """What the grounds have of one agent, by their clocks. received: when they received it; cover: when they recorded; armed: whether
    they received its autopilot."""

    seen: Observed = field(default_factory=dict)
    received: list[Span] = field(default_factory=list)
    cover: list[Span] = field(default_factory=list)
    armed: bool = False


@dataclass
class _Group:
    """Runs of one start of a machine, by their own UTC. failing: from when to when the log has this failure; armed: whether it says
    when the autopilot was armed."""

    runs: list[tuple[Run, RunClock]]
    seen: Observed = field(default_factory=dict)
    failing: dict[Key, list[Span]] = field(default_factory=dict)
    cover: list[Span] = field(default_factory=list)
    armed: bool = False
    found: Agreed | None = None
    votes: int = 0

    def moved(self, offset_s: float) -> list[Span]:
        return [[begin + offset_s, end + offset_s] for begin, end in self.cover]


def align(runs: Sequence[tuple[Run, RunClock]], grounds: Sequence[tuple[GroundRun, RunClock]]) -> None:
    """Correct the clocks of the runs where the ground's record is enough for it; `by` says why not."""
    if not grounds:
        return
    together: dict[object, list[tuple[Run, RunClock]]] = {}
    for run, clock in runs:
        together.setdefault(machine(run) or id(run), []).append((run, clock))
    agents: dict[tuple[str, int], list[_Group]] = {}
    for members in together.values():
        agents.setdefault((members[0][0].agent, members[0][0].agent_id), []).append(_group(members))
    known: dict[int, _Received] = {}
    for (_, number), groups in agents.items():
        if number not in known:
            known[number] = _received(grounds, number)
        for group in groups:
            _find(group, known[number])
        _place(groups)


def _find(group: _Group, received: _Received) -> None:
    """The offset for which there is enough evidence, into `group.found`."""
    common = group.seen.keys() & received.seen.keys()
    agreed = candidate(
        [theirs - own for key in common for theirs, own in compared(received.seen[key], group.seen[key])]
    )
    if agreed is None:
        _say(group, SEVERAL if common else NOTHING)
        return
    mine, theirs = _weights(group, received, agreed[0])
    if why := too_little(agreed[0], mine, theirs, overlapping=bool(both(received.cover, group.cover))):
        _say(group, f"its own clock: of the lines and armings that the ground also received, {why}")
        return
    group.found, group.votes = agreed, min(len(mine.agreed), len(theirs.agreed))


def _weights(group: _Group, received: _Received, offset_s: float) -> tuple[Weight, Weight]:
    """For and against an offset: of what the log has, and of what the ground has."""
    armed = group.armed and received.armed

    def was_received(key: Key, at: float) -> bool:
        return (armed or key[0] != ARMED) and within(received.received, at, WINDOW_S)

    def logged(key: Key, at: float) -> bool:
        """What still fails is sent again to a later ground station: the log has no new line of that."""
        again = within(group.failing.get(key, ()), at)
        return (armed or key[0] != ARMED) and within(group.cover, at, WINDOW_S) and not again

    return weigh(group.seen, received.seen, offset_s, was_received), weigh(received.seen, group.seen, -offset_s, logged)


def _place(groups: Sequence[_Group]) -> None:
    """Move the runs of one agent, those with most votes first, but not to where another one was: those that stay go first."""
    staying = [group for group in groups if group.found is None or abs(group.found[0]) <= NEAR_S]
    taken = joined(span for group in staying for span in group.moved(group.found[0] if group.found else 0.0))
    leaving = [group for group in groups if group.found is not None and abs(group.found[0]) > NEAR_S]
    for group in sorted(leaving, key=lambda group: -group.votes):
        offset_s, error_s, _ = group.found or (0.0, 0.0, 0)
        there = group.moved(offset_s)
        if total(both(taken, there)) > SAME_S + error_s:
            shown = f"{group.votes} {BY}, agree at {offset_s:+.1f} s"
            _say(group, f"its own clock: {shown}, {TAKEN}")
            group.found, there = None, group.moved(0.0)
        taken = joined([*taken, *there])
    for group in groups:
        _apply(group)


def _apply(group: _Group) -> None:
    if group.found is None:
        return
    offset_s, error_s, _ = group.found
    for _, clock in group.runs:
        clock.offset_s, clock.error_s, clock.votes = offset_s, error_s, group.votes
        clock.by, clock.applied = BY, abs(offset_s) > error_s
        if clock.applied:
            clock.shift += offset_s


def _say(group: _Group, why: str) -> None:
    for _, clock in group.runs:
        clock.by = why


def _group(members: list[tuple[Run, RunClock]]) -> _Group:
    """What the logs have, in the order of time."""
    made = _Group(members)
    for run, clock in members:
        failing: dict[str, tuple[Key, float]] = {}
        for change in run.changes:
            at = clock.t(change.mono)
            if change.unit in failing:
                key, since = failing.pop(change.unit)
                made.failing.setdefault(key, []).append([since, at])
            slot = run.units.get(change.unit, {}).get("slot")
            if slot not in SLOTS or change.level not in ("ERROR", "WARN"):
                continue
            line = status_line.failing(run.agent_id, Level[change.level], Slot(slot), change.brief or change.unit)
            key = (slot, change.level, " ".join(line.split(" ", 3)[3:]))  # as the ground receives it
            failing[change.unit] = key, at
            if not change.text_only:
                made.seen.setdefault(key, []).append(at)
        end = max((clock.t(span[1]) for span in run.cover.spans), default=0.0)
        for key, since in failing.values():
            made.failing.setdefault(key, []).append([since, max(since, end)])
        for mark in run.marks:
            if mark.what == "flight" and not mark.body.get("continued"):
                made.seen.setdefault((ARMED, bool(mark.body["began"])), []).append(clock.t(mark.mono))
        made.armed = made.armed or bool(run.armed) or any(mark.what == "flight" for mark in run.marks)
    made.cover = joined([clock.t(begin), clock.t(end)] for run, clock in members for begin, end in run.cover.spans)
    made.failing = {key: joined(spans) for key, spans in made.failing.items()}
    for times in made.seen.values():
        times.sort()
    return made


def _received(grounds: Iterable[tuple[GroundRun, RunClock]], agent: int) -> _Received:
    found = _Received()
    for ground, clock in grounds:
        for mono, which, slot, word, brief in ground.texts:
            if which == agent and word in WORDS:
                found.seen.setdefault((slot, WORDS[word], brief), []).append(clock.t(mono))
        was: bool | None = None
        for mono, system, armed in ground.armed:
            if system == agent:
                found.armed = True
                if was is not None and armed is not was:
                    found.seen.setdefault((ARMED, armed), []).append(clock.t(mono))
                was = armed
        found.cover += [[clock.t(begin), clock.t(end)] for begin, end in ground.cover.spans]
        found.received += [[clock.t(begin), clock.t(end)] for begin, end in _spans(ground, agent)]
    found.cover, found.received = joined(found.cover), joined(found.received)
    for times in found.seen.values():
        times.sort()
    return found


def _spans(ground: GroundRun, agent: int) -> list[Span]:
    """When the ground received this agent: from its first line on, without the times for which it was lost."""
    edges = sorted(
        (mono, said == "alive", silent_s) for mono, which, said, silent_s in ground.presence if which == agent
    )
    first = [one[0] for one in ground.levels if one[1] == agent] + [one[0] for one in ground.texts if one[1] == agent]
    first += [edge[0] for edge in edges if edge[1]]
    end = max((span[1] for span in ground.cover.spans), default=0.0)
    found: list[Span] = []
    since: float | None = min(first, default=None)
    for mono, alive, silent_s in edges:
        if alive:
            since = mono if since is None else since
        elif since is not None:
            found.append([since, max(since, mono - silent_s)])
            since = None
    if since is not None:
        found.append([since, max(since, end)])
    return both(joined(ground.cover.spans), joined(found))
