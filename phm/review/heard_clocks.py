"""The clocks of agents that the ground does not place, by the heartbeats that they and others received."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from phm.review.clocks import REFERENCE, RunClock, begin_of, end_of, taken
from phm.review.run import Run
from phm.review.votes import MOST_EACH, MOST_OTHER, NEAR_S, vote

WIDTH_HEARD_S, HEARD_ERROR_S = 0.6, 0.2
"""As the window and the error of votes: heartbeats that two agents received differ by delays of the links only."""
LEAST_HEARD = 5
"""A smaller number of heartbeats could agree by chance."""
SHARE_HEARD = 0.5
"""Of the frames that both can have received at least this share must agree."""


def align_together(runs: Sequence[tuple[Run, RunClock]]) -> None:
    """Compare the runs that the ground does not place with those that it does, else with the longest one.

    By heartbeats that both have received: a frame has a number from 0 to 255, so the same number comes again and again, and the
    right offset is the one at which most of them agree.
    """
    placed = [one for one in runs if one[1].offset_s is not None]
    open_ones = [one for one in runs if one[1].offset_s is None and one[0].heard]
    chosen = None
    if not placed and open_ones:
        chosen = max(open_ones, key=lambda one: end_of(one[0].cover.spans) - begin_of(one[0].cover.spans))
        placed = [chosen]
    for run, clock in open_ones:
        if any(run is other for other, _ in placed):
            continue
        others = [one for one in placed if (one[0].agent, one[0].agent_id) != (run.agent, run.agent_id)]
        agreed = vote(list(_heard_by_both(run, clock, others)), WIDTH_HEARD_S, HEARD_ERROR_S, most_other=MOST_OTHER)
        if agreed is None or agreed[2] < max(LEAST_HEARD, SHARE_HEARD * _expected(run, clock, others, agreed[0])):
            continue
        if abs(agreed[0]) > NEAR_S and taken(run, clock, agreed[0], runs):
            clock.by = f"its own clock: {agreed[2]} heartbeats agree at {agreed[0]:+.1f} s, but another run of this agent is there"
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
