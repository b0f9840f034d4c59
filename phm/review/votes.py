"""An offset between two clocks by what both records have: pairs of equal observations vote, and what agrees is weighed.

A pair may be equal by chance: each flight has an arming, and a node that dies says the same each day. So the own clock of a
record is kept unless there is enough evidence that it is wrong; the further the offset moves it, the more is needed.
"""

from __future__ import annotations

import itertools
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

WINDOW_S = 2.5
"""Votes for one offset differ at most by this: an autopilot's heartbeat comes once a second, a line may wait for the radio."""
OWN_ERROR_S = 1.0
"""Is added to half of the spread of the votes, because all of them may be late."""
MOST_EACH = 60
"""Observations of one kind that are compared: the first ones, and as many near each of the other record."""
MOST_OTHER = 0.8
"""Another offset may have at most this share of the votes: what comes again at even intervals fits several offsets."""
NEAR_S, FAR_S = 10.0, 300.0
"""Up to NEAR_S one observation is enough. Above FAR_S, and where the records do not overlap by their own clocks, most is needed."""
SHARE = 0.5
"""Of what both records could have at least this share must agree."""
MOMENT_S = 30.0
"""Observations with shorter pauses are one moment: a failure, what follows from it and the recovery come together each time."""
MOMENTS, MOMENTS_FAR, MOMENTS_ALIKE = 2, 3, 6
"""Moments that must agree above NEAR_S; far away; and far away if all are of one kind."""
SAME_S = 5.0
"""Runs of one agent may overlap by so much and their error."""
Key = tuple[object, ...]
Times = Mapping[Key, Sequence[float]]
Agreed = tuple[float, float, int]
"""Offset, error and number of votes."""


@dataclass
class Weight:
    """What is for and against an offset, of one record against the other.

    agreed: kind and time of the observations that the other one has, too. possible: how many it could have.
    """

    agreed: list[tuple[object, float]] = field(default_factory=list)
    possible: int = 0

    @property
    def share(self) -> float:
        return len(self.agreed) / self.possible if self.possible else 0.0


def weigh(
    mine: Times,
    theirs: Times,
    offset_s: float,
    possible: Callable[[Key, float], bool],
    kind: Callable[[Key], object] = lambda key: key[0],
) -> Weight:
    """Which of my times, moved by the offset, the other record has within WINDOW_S.

    possible: whether the other record could have an observation of this kind at this time, by its clock.
    """
    found = Weight()
    for key, times in mine.items():
        other = theirs.get(key, ())
        for time in times:
            at = time + offset_s
            if bisect_right(other, at + WINDOW_S) > bisect_left(other, at - WINDOW_S):
                found.agreed.append((kind(key), at))
                found.possible += 1
            elif possible(key, at):
                found.possible += 1
    return found


def too_little(offset_s: float, mine: Weight, theirs: Weight, *, overlapping: bool) -> str:
    """Why an offset is not used, empty if it is. overlapping: by their own clocks the records are of the same time."""
    near = abs(offset_s) <= NEAR_S
    least, count = min((mine, theirs), key=lambda one: one.share), len(theirs.agreed)
    shown = f"{count} agree{'s' if count == 1 else ''} at {offset_s:+.1f} s"
    if (max(mine.share, theirs.share) if near else least.share) < SHARE:
        return f"{shown}, less than half of the {least.possible} that both records can have"
    if near:
        return ""
    far = not overlapping or abs(offset_s) > FAR_S
    seen, needed = moments(at for _, at in theirs.agreed), MOMENTS_FAR if far else MOMENTS
    if seen < needed:
        return f"{shown}, at {seen} moment{'' if seen == 1 else 's'}: {needed} are needed for so large an offset"
    if far and seen < MOMENTS_ALIKE and len({one for one, _ in theirs.agreed}) < 2:
        return f"{shown}, all of one kind: {MOMENTS_ALIKE} moments are needed for so large an offset"
    return ""


def moments(times: Iterable[float]) -> int:
    """How many groups of times with pauses of MOMENT_S between them."""
    ordered = sorted(times)
    return bool(ordered) + sum(after - before >= MOMENT_S for before, after in itertools.pairwise(ordered))


def candidate(differences: Sequence[float]) -> Agreed | None:
    """The offset with most votes; with as many, one at which the own clock is nearly right."""
    near = vote([one for one in differences if abs(one) <= NEAR_S])
    best = vote(differences, most_other=MOST_OTHER)
    return near if near is not None and (best is None or near[2] >= best[2]) else best


def vote(
    differences: Sequence[float], window_s: float = WINDOW_S, error_s: float = OWN_ERROR_S, most_other: float = 0.999
) -> Agreed | None:
    """None when there is no vote, or another offset has nearly as many.

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


def within(spans: Sequence[Sequence[float]], time: float, margin_s: float = 0.0) -> bool:
    """Whether a time is in one of these joined spans, at least margin_s from its ends."""
    place = bisect_right(spans, time, key=lambda span: span[0]) - 1
    return place >= 0 and spans[place][0] + margin_s <= time <= spans[place][1] - margin_s
