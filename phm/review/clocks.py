"""One time axis for all records: that of the ground, or of each agent where no ground says more.

A run of PHM has one monotonic clock, which never jumps, so all its lines have right distances. What may be wrong is where the run
lies in UTC: `ground_clocks` and `heartbeat_clocks` compare it with other records.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from phm.review.agent_run import Run
from phm.review.ground_part import GroundRun
from phm.review.spans import both, joined, total
from phm.review.utc_steps import STEP_S
from phm.review.votes import SAME_S

REFERENCE = "reference of the other agents"


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
    """The clock of a run by its own UTC: the difference of UTC and monotonic time that held longest.

    clock: as in `Run.clock`. end: of the run, in monotonic seconds.
    """
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
    return {ground.run: own_clock(ground.clock, end_of(ground.cover.spans)) for ground in grounds}


def ordered_clock(clock: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Without the first lines of segments, which repeat the difference before."""
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
        together.setdefault(machine(run) or id(run), []).append(run)
    found: dict[int, RunClock] = {}
    for group in together.values():
        merged = ordered_clock(each for run in group for each in run.clock)
        whole = own_clock(merged, max(end_of(run.cover.spans) for run in group))
        for run in group:
            begin, end = begin_of(run.cover.spans), end_of(run.cover.spans)
            found[id(run)] = RunClock(whole.shift, steps=tuple(one for one in whole.steps if begin <= one[0] <= end))
    return [found[id(run)] for run in runs]


def machine(run: Run) -> tuple[str, int, str] | None:
    """The start of the machine in which it ran; None: unknown."""
    return (run.agent, run.agent_id, run.machine_boot) if run.machine_boot else None


def follow_machine(runs: Sequence[tuple[Run, RunClock]]) -> None:
    """Runs of an agent that nothing places follow one of the same start of the machine that is placed, with most votes."""
    for run, clock in runs:
        placed = [its for other, its in runs if machine(other) == machine(run) and its.votes]
        if clock.offset_s is None and machine(run) and placed:
            best = max(placed, key=lambda one: one.votes)
            clock.shift, clock.offset_s, clock.error_s = best.shift, best.offset_s, best.error_s
            clock.applied, clock.by = best.applied, "another run since the same start of the machine"


def taken(run: Run, clock: RunClock, offset_s: float, runs: Sequence[tuple[Run, RunClock]]) -> bool:
    """Whether another run of this agent is where the offset would move this one."""
    there = joined([clock.t(begin) + offset_s, clock.t(end) + offset_s] for begin, end in run.cover.spans)
    mine = [one for one in runs if (one[0].agent, one[0].agent_id) == (run.agent, run.agent_id) and one[0] is not run]
    return any(
        total(both(there, joined([its.t(begin), its.t(end)] for begin, end in other.cover.spans))) > SAME_S
        for other, its in mine
    )


def begin_of(spans: Sequence[Sequence[float]]) -> float:
    """The earliest begin of the spans, in seconds; 0 without a span."""
    return min((span[0] for span in spans), default=0.0)


def end_of(spans: Sequence[Sequence[float]]) -> float:
    """The latest end of the spans, in seconds; 0 without a span."""
    return max((span[1] for span in spans), default=0.0)
