"""The clocks of runs that neither the ground nor heartbeats place, by the autopilot, which went on while PHM or its computer
restarted: its time since boot says how long the pause was.

A clock that was not set is behind, never ahead, so a run is only moved forward. That is what distinguishes it from a reboot of the
autopilot in the pause: with right clocks, a later boot looks like an offset backward.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from phm.review.agent_run import Run
from phm.review.clocks import RunClock, begin_of, end_of, machine, taken
from phm.review.external_entry import EARLIEST_S
from phm.review.votes import OWN_ERROR_S, WINDOW_S

BY = "the autopilot's time since boot, as in another run"
Placed = tuple[Run, RunClock]


def continue_by_autopilot(runs: Sequence[Placed]) -> None:
    """Place the runs of one agent. runs: in the order of their times.

    A run is compared with the one before it. One whose clock was never set is compared with all others: its place among them is
    unknown, so those that fit must agree.
    """
    ends = {id(run): (begin_of(run.cover.spans), end_of(run.cover.spans)) for run, _ in runs}

    def unset(one: Placed) -> bool:
        return one[1].t(ends[id(one[0])][0]) < EARLIEST_S

    for place, (run, clock) in enumerate(runs):
        if clock.offset_s is not None or not run.boots:
            continue
        alone = unset((run, clock))
        others = [one for one in runs if not unset(one)] if alone else runs[max(0, place - 1) : place]
        found = [one for other in others for one in _offsets(other, (run, clock), ends, either=alone)]
        offsets = [offset_s for offset_s, _, _ in found]
        if not found or max(offsets) - min(offsets) > WINDOW_S:
            continue
        offset_s, error_s, lines = min(found, key=lambda one: one[1])
        if offset_s <= error_s or taken(run, clock, offset_s, runs):
            continue
        clock.offset_s, clock.error_s, clock.votes = offset_s, error_s, lines
        clock.by, clock.applied = BY, True
        clock.shift += offset_s


def _offsets(
    other: Placed, mine: Placed, ends: Mapping[int, tuple[float, float]], *, either: bool
) -> Iterator[tuple[float, float, int]]:
    """Offset, error and number of lines if the autopilot went on from the other run to mine. ends: begin and end of each run, on its
    clock. either: or from mine to the other."""
    (run, clock), (their, its) = mine, other
    if run is their or not their.boots or (machine(run) and machine(run) == machine(their)):
        return
    for before, after, allowed in ((their, run, True), (run, their, either)):
        last, first = before.boots[max(before.boots)], after.boots[min(after.boots)]
        went_on = ends[id(after)][0] - first[1] >= ends[id(before)][1] - last[1]
        if went_on and allowed:
            ours, theirs = (first, last) if after is run else (last, first)
            error_s = (ours[2] - ours[1] + theirs[2] - theirs[1]) / 2 + OWN_ERROR_S
            known_s = its.error_s or 0.0 if its.applied else 0.0
            yield its.t(theirs[1]) - clock.t(ours[1]), error_s + known_s, int(min(ours[0], theirs[0]))
