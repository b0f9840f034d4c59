"""The clocks of runs that lines and armings do not place, by the heartbeats that the ground or another agent has, too.

A frame has a number from 0 to 255, so the same number comes again and again, and the right offset is the one at which most frames of
one sender agree. A sender of nothing but heartbeats has them at even intervals: then a record of another day agrees as well.
"""

from __future__ import annotations

import itertools
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence

from phm.review.agent_run import Run
from phm.review.clocks import REFERENCE, RunClock, begin_of, end_of, taken
from phm.review.ground_part import GroundRun
from phm.review.votes import MOST_EACH, MOST_OTHER, NEAR_S, Agreed, vote

WIDTH_RECEIVED_S, RECEIVED_ERROR_S = 0.6, 0.2
"""As the window and the error of votes: heartbeats that two records have differ by delays of the links only."""
LEAST_RECEIVED = 5
"""A smaller number of heartbeats could agree by chance."""
SHARE_RECEIVED = 0.5
"""Of the frames that both can have at least this share must agree."""
LEAST_UNEVEN = 5
"""Above NEAR_S so many intervals must differ from even ones."""
MOST_SENDERS = 256
"""As agents log them; of more, those with most frames."""
BY_GROUND = "heartbeats that the ground also received or sent"
BY_AGENT = "heartbeats that another agent also received"
Frame = tuple[int, int, int]
Received = Mapping[Frame, Sequence[float]]
Source = tuple[Received, RunClock]


def align_by_heartbeats(runs: Sequence[tuple[Run, RunClock]], grounds: Sequence[tuple[GroundRun, RunClock]]) -> None:
    """Compare the runs that are not placed with the grounds; then those that are still not with the others, or the longest one."""
    for run, clock in runs:
        if clock.offset_s is None and run.received:
            _align(run, clock, [(ground.received, its) for ground, its in grounds], runs, BY_GROUND)
    placed = [one for one in runs if one[1].offset_s is not None]
    open_ones = [one for one in runs if one[1].offset_s is None and one[0].received]
    chosen = None
    if not placed and open_ones:
        chosen = max(open_ones, key=lambda one: end_of(one[0].cover.spans) - begin_of(one[0].cover.spans))
        placed = [chosen]
    for run, clock in open_ones:
        if any(run is other for other, _ in placed):
            continue
        others = [one for one in placed if (one[0].agent, one[0].agent_id) != (run.agent, run.agent_id)]
        found = _align(run, clock, [(other.received, its) for other, its in others], runs, BY_AGENT)
        if found and chosen is not None:
            chosen[1].by = REFERENCE


def _align(run: Run, clock: RunClock, others: Sequence[Source], runs: Sequence[tuple[Run, RunClock]], by: str) -> bool:
    agreed = _best(run.received, clock, others)
    if agreed is None:
        return False
    if abs(agreed[0]) > NEAR_S and taken(run, clock, agreed[0], runs):
        clock.by = (
            f"its own clock: {agreed[2]} heartbeats agree at {agreed[0]:+.1f} s, but another run of this agent is there"
        )
        return False
    clock.offset_s, clock.error_s, clock.votes = agreed
    clock.by, clock.applied = by, abs(agreed[0]) > agreed[1]
    if clock.applied:
        clock.shift += agreed[0]
    return True


def _best(received: Received, clock: RunClock, others: Sequence[Source]) -> Agreed | None:
    """The offset with most votes of the senders that have enough of them. A router or an autopilot may give a sender's frames other
    numbers on each link, so each sender is looked at on its own."""
    found: list[Agreed] = []
    mine_of = _by_sender(received, clock)
    theirs_of = [_by_sender(their, its) for their, its in others]
    for sender in sorted(mine_of, key=lambda sender: (-len(mine_of[sender]), sender))[:MOST_SENDERS]:
        mine = mine_of[sender]
        theirs = [of_sender[sender] for of_sender in theirs_of if sender in of_sender]
        differences = list(_differences(mine, theirs))
        near = [one for one in differences if abs(one) <= NEAR_S]
        for chosen in (near, differences):
            agreed = vote(chosen, WIDTH_RECEIVED_S, RECEIVED_ERROR_S, most_other=MOST_OTHER)
            if agreed is not None and _enough(mine, theirs, agreed):
                found.append(agreed)
                break
    return max(found, key=lambda one: one[2], default=None)


def _by_sender(received: Received, clock: RunClock) -> dict[tuple[int, int], dict[Frame, list[float]]]:
    """By system and component, on the reference's clock as far as that is known."""
    found: dict[tuple[int, int], dict[Frame, list[float]]] = {}
    for frame, times in received.items():
        found.setdefault(frame[:2], {})[frame] = [clock.t(at) for at in times]
    return found


def _enough(mine: Received, theirs: Sequence[Received], agreed: Agreed) -> bool:
    offset_s, _, votes = agreed
    if votes < max(LEAST_RECEIVED, SHARE_RECEIVED * _expected(mine, theirs, offset_s)):
        return False
    return abs(offset_s) <= NEAR_S or _uneven(mine, theirs, offset_s) >= LEAST_UNEVEN


def _expected(mine: Received, theirs: Sequence[Received], offset_s: float) -> int:
    """How many frames both can have at most if that is the offset: the fewer of those that each has meanwhile."""
    own, found = sorted(at + offset_s for times in mine.values() for at in times), 0
    for their in theirs:
        other = sorted(at for times in their.values() for at in times)
        if own and other:
            meanwhile = bisect_right(own, other[-1]) - bisect_left(own, other[0])
            found = max(found, min(meanwhile, bisect_right(other, own[-1]) - bisect_left(other, own[0])))
    return found


def _uneven(mine: Received, theirs: Sequence[Received], offset_s: float) -> int:
    """How many intervals between the frames that agree are not as long as the difference of their numbers says."""
    both = sorted((at, frame[2]) for frame, times in mine.items() for at in times if _has(theirs, frame, at + offset_s))
    steps = [
        (after[0] - before[0], (after[1] - before[1]) % 256)
        for before, after in itertools.pairwise(both)
        if after[1] != before[1]
    ]
    if not steps:
        return 0
    period_s = statistics.median(length_s / count for length_s, count in steps)
    return sum(abs(length_s - count * period_s) > WIDTH_RECEIVED_S for length_s, count in steps)


def _has(theirs: Sequence[Received], frame: Frame, at: float) -> bool:
    return any(abs(other - at) <= WIDTH_RECEIVED_S for their in theirs for other in their.get(frame, ())[:MOST_EACH])


def _differences(mine: Received, theirs: Sequence[Received]) -> Iterator[float]:
    """Of each frame number that both have, all differences of its times."""
    for their in theirs:
        for frame, times in mine.items():
            for other in their.get(frame, ())[:MOST_EACH]:
                for own in times[:MOST_EACH]:
                    yield other - own
