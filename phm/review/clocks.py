"""One time axis for all records: that of the ground, or of each agent where no ground says more.

A run of PHM has one monotonic clock, which never jumps, so all its lines have right distances. What may be wrong is where the run
lies in UTC. Two things are observed by an agent and by the ground at nearly the same time: the autopilot's heartbeat that says
armed or disarmed for the first time, and a line about a change, which the ground receives within a second. Each pair of
such observations is a vote for an offset; the offset is where most votes agree.
"""

from __future__ import annotations

import itertools
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from phm.review.events import WORDS
from phm.review.ground_part import GroundRun
from phm.review.part import STEP_S
from phm.review.run import Run

WINDOW_S = 2.5
"""Votes for one offset differ at most by this: an autopilot's heartbeat comes once a second, a line may wait for the radio."""
OWN_ERROR_S = 1.0
"""Is added to half of the spread of the votes, because all of them may be late."""
WIDTH_HEARD_S, HEARD_ERROR_S = 0.6, 0.2
"""The same for heartbeats that two agents received: they differ by delays of the links only."""
REFERENCE = "reference of the other agents"
LEAST_HEARD = 5
"""A smaller number of heartbeats could agree by chance."""
SHARE_HEARD, MOST_OTHER = 0.5, 0.8
"""Of the frames that both can have received at least this share must agree. And another offset may have at most this share of the
votes: numbers that come again at even intervals fit several offsets."""
MOST_EACH = 60
"""Observations of one kind that are compared: the first ones, and as many near each of the other record."""
Observed = dict[tuple[object, ...], list[float]]


@dataclass
class RunClock:
    """How the monotonic clock of a run becomes UTC: `t = mono + shift`.

    offset_s: what was added to the run's own UTC to get the reference's; None: unknown. error_s: how wrong that may be. by: what
    it is derived from. applied: the offset is larger than its error, so it is part of `shift`. steps: jumps of the run's UTC.
    """

    shift: float
    offset_s: float | None = None
    error_s: float | None = None
    votes: int = 0
    by: str = ""
    applied: bool = False
    steps: tuple[tuple[float, float], ...] = ()

    def t(self, mono: float) -> float:
        return mono + self.shift


def own_clock(clock: Sequence[tuple[float, float]], end: float) -> RunClock:
    """By the run's own UTC: of the differences of its two clocks the one that held longest. clock: as in `Run.clock`."""
    if not clock:
        return RunClock(0.0)
    held: list[tuple[float, float, float]] = []
    for place, (mono, difference) in enumerate(clock):
        until = clock[place + 1][0] if place + 1 < len(clock) else max(end, mono)
        held.append((until - mono, mono, difference))
    shift = max(held)[2]
    pairs = itertools.pairwise(clock)
    steps = [(after[0], after[1] - before[1]) for before, after in pairs if abs(after[1] - before[1]) > STEP_S]
    return RunClock(shift, steps=tuple(steps))


def ground_clock(grounds: Iterable[GroundRun]) -> dict[str, RunClock]:
    return {ground.run: own_clock(ground.clock, _end(ground.cover.spans)) for ground in grounds}


def ordered_clock(clock: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Without the first lines of pieces, which repeat the difference before."""
    kept: list[tuple[float, float]] = []
    for mono, difference in sorted(clock):
        if not kept or abs(difference - kept[-1][1]) > STEP_S:
            kept.append((mono, difference))
    return kept


def own_clocks(runs: Sequence[Run]) -> list[RunClock]:
    """The clock of each run by its own UTC. Runs of one start of the machine have one monotonic clock, so the same shift: the
    machine's clock may have been set while PHM restarted, or between two reloads of its configuration."""
    together: dict[object, list[Run]] = {}
    for run in runs:
        together.setdefault(_machine(run) or id(run), []).append(run)
    found: dict[int, RunClock] = {}
    for group in together.values():
        merged = ordered_clock(each for run in group for each in run.clock)
        whole = own_clock(merged, max(_end(run.cover.spans) for run in group))
        for run in group:
            begin, end = _begin(run.cover.spans), _end(run.cover.spans)
            found[id(run)] = RunClock(whole.shift, steps=tuple(one for one in whole.steps if begin <= one[0] <= end))
    return [found[id(run)] for run in runs]


def _machine(run: Run) -> tuple[str, int, str] | None:
    return (run.agent, run.agent_id, run.machine_boot) if run.machine_boot else None


def follow_machine(runs: Sequence[tuple[Run, RunClock]]) -> None:
    """Runs of an agent that nothing places follow one of the same start of the machine that is placed, with most votes."""
    for run, clock in runs:
        placed = [its for other, its in runs if _machine(other) == _machine(run) and its.votes]
        if clock.offset_s is None and _machine(run) and placed:
            best = max(placed, key=lambda one: one.votes)
            clock.shift, clock.offset_s, clock.error_s = best.shift, best.offset_s, best.error_s
            clock.applied, clock.by = best.applied, "another run of the same start of the machine"


def align(run: Run, clock: RunClock, grounds: Sequence[tuple[GroundRun, RunClock]]) -> None:
    """Correct the clock of a run by the ground where that is possible."""
    mine = _of_agent(run, clock)
    heard: Observed = {}
    for ground, its in grounds:
        for key, times in _of_ground(ground, its, run.agent_id).items():
            heard.setdefault(key, []).extend(times)
    differences = [
        theirs - own for key in mine.keys() & heard.keys() for theirs, own in compared(sorted(heard[key]), mine[key])
    ]
    agreed = vote(differences)
    if agreed is None:
        if grounds:
            clock.by = "the ground received nothing that the log has, too: no line about a change and no arming"
        return
    clock.offset_s, clock.error_s, clock.votes = agreed
    clock.by = "lines and armings that the ground received, too"
    clock.applied = abs(agreed[0]) > agreed[1]
    if clock.applied:
        clock.shift += agreed[0]


def compared(one: Sequence[float], other: Sequence[float]) -> Iterator[tuple[float, float]]:
    """Pairs of times of two lists in order. Of long ones the first times, and those that are near if the clocks are nearly right: one
    record may be of a small part of the other."""
    if len(one) > len(other):
        yield from ((first, second) for second, first in compared(other, one))
        return
    for time in one[:MOST_EACH]:
        first, near = min(MOST_EACH, len(other)), bisect_left(other, time)
        yield from ((time, each) for each in other[:first])
        yield from ((time, each) for each in other[max(first, near - MOST_EACH // 2) : near + MOST_EACH // 2])


def align_together(runs: Sequence[tuple[Run, RunClock]]) -> None:
    """Compare the runs that the ground does not place with those that it does, else with the longest one.

    By heartbeats that both have received: a frame has a number from 0 to 255, so the same number comes again and again, and the
    right offset is the one at which most of them agree.
    """
    placed = [one for one in runs if one[1].offset_s is not None]
    open_ones = [one for one in runs if one[1].offset_s is None and one[0].heard]
    chosen = None
    if not placed and open_ones:
        chosen = max(open_ones, key=lambda one: _end(one[0].cover.spans) - _begin(one[0].cover.spans))
        placed = [chosen]
    for run, clock in open_ones:
        if any(run is other for other, _ in placed):
            continue
        agreed = vote(list(_heard_by_both(run, clock, placed)), WIDTH_HEARD_S, HEARD_ERROR_S, most_other=MOST_OTHER)
        if agreed is None or agreed[2] < max(LEAST_HEARD, SHARE_HEARD * _expected(run, clock, placed, agreed[0])):
            continue
        clock.offset_s, clock.error_s, clock.votes = agreed
        clock.by = "heartbeats that another agent received, too"
        clock.applied = abs(agreed[0]) > agreed[1]
        if clock.applied:
            clock.shift += agreed[0]
        if chosen is not None:
            chosen[1].by = REFERENCE


def _expected(run: Run, clock: RunClock, placed: Sequence[tuple[Run, RunClock]], offset_s: float) -> int:
    """How many frames both can have received at most if that is the offset: the fewer of those that each received meanwhile."""

    def count(times: list[float], others: list[float]) -> int:
        return sum(others[0] <= at <= others[-1] for at in times) if others else 0

    mine = sorted(clock.t(at) + offset_s for times in run.heard.values() for at in times)
    found = 0
    for other, its in placed:
        theirs = sorted(its.t(at) for times in other.heard.values() for at in times)
        found = max(found, min(count(mine, theirs), count(theirs, mine)))
    return found


def _heard_by_both(run: Run, clock: RunClock, placed: Sequence[tuple[Run, RunClock]]) -> Iterator[float]:
    """Of each frame number that both have, all differences of its times."""
    for other, its in placed:
        for frame, mine in run.heard.items():
            for theirs in other.heard.get(frame, ())[:MOST_EACH]:
                for own in mine[:MOST_EACH]:
                    yield its.t(theirs) - clock.t(own)


def vote(
    differences: Sequence[float], window_s: float = WINDOW_S, error_s: float = OWN_ERROR_S, most_other: float = 0.999
) -> tuple[float, float, int] | None:
    """(offset, error, number of votes); None when there is none, or another offset has nearly as many votes.

    window_s: votes for one offset differ at most by this. error_s: is added to half of their spread. most_other: what share of its
    votes another offset may have.
    """
    ordered = sorted(differences)
    if not ordered:
        return None
    ranges = [(bisect_right(ordered, first + window_s), place) for place, first in enumerate(ordered)]
    end, begin = max(ranges, key=lambda one: one[0] - one[1])
    chosen = ordered[begin:end]
    for other_end, other in ranges:
        apart = ordered[other] > chosen[-1] + window_s or ordered[other_end - 1] < chosen[0] - window_s
        if apart and other_end - other > most_other * len(chosen):
            return None
    return statistics.median(chosen), (chosen[-1] - chosen[0]) / 2 + error_s, len(chosen)


def continue_by_autopilot(before: tuple[Run, RunClock], run: Run, clock: RunClock) -> None:
    """Place a later run of the same agent by the autopilot, which went on while PHM restarted.

    Only where the two clocks disagree by more than their error although the autopilot has not rebooted: its time since boot has
    grown.
    """
    earlier, its = before
    if clock.offset_s is not None or not earlier.boots or not run.boots:
        return
    last, first = earlier.boots[max(earlier.boots)], run.boots[min(run.boots)]
    went_on = (_begin(run.cover.spans) - first[1]) >= (_end(earlier.cover.spans) - last[1])
    offset, error = its.t(last[1]) - clock.t(first[1]), (last[2] - last[1] + first[2] - first[1]) / 2 + OWN_ERROR_S
    if not went_on or abs(offset) <= error:
        return
    clock.offset_s, clock.error_s, clock.votes = offset, error, int(min(last[0], first[0]))
    clock.by, clock.applied = "the autopilot's time since boot, as in the run before", True
    clock.shift += offset


def _of_agent(run: Run, clock: RunClock) -> Observed:
    found: Observed = {}
    for change in run.changes:
        if change.brief and change.level in ("ERROR", "WARN") and not change.text_only:
            slot = run.units.get(change.unit, {}).get("slot")
            found.setdefault((slot, change.level, change.brief), []).append(clock.t(change.mono))
    for mark in run.marks:
        if mark.what == "flight" and not mark.body.get("continued"):
            found.setdefault(("armed", bool(mark.body["began"])), []).append(clock.t(mark.mono))
    return found


def _of_ground(ground: GroundRun, clock: RunClock, agent: int) -> Observed:
    found: Observed = {}
    for mono, which, slot, word, brief in ground.texts:
        if which == agent and word in WORDS:
            found.setdefault((slot, WORDS[word], brief), []).append(clock.t(mono))
    was: bool | None = None
    for mono, system, armed in ground.armed:
        if system == agent:
            if was is not None and armed is not was:
                found.setdefault(("armed", armed), []).append(clock.t(mono))
            was = armed
    return found


def _begin(spans: Sequence[Sequence[float]]) -> float:
    return min((span[0] for span in spans), default=0.0)


def _end(spans: Sequence[Sequence[float]]) -> float:
    return max((span[1] for span in spans), default=0.0)
