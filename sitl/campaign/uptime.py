"""The share of time that PHM was up, as seen by a ground station. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from sitl.campaign.trial import Trial

GAP = 1.5
"""A pause between two heartbeats longer than so many of their periods is a gap; one lost frame makes one, too."""

Span = tuple[float, float]


def gaps(times: Sequence[float], period_s: float, ended: float) -> list[Span]:
    """When the heartbeat was overdue: from its due time to its arrival, or to the end of the measurement."""
    pauses = pairwise([*sorted(times), ended])
    return [(start + period_s, end) for start, end in pauses if end - start > GAP * period_s]


def without(span: Span, holes: Sequence[Span]) -> list[Span]:
    """The rest of a span without the holes; in order."""
    left = [span] if span[1] > span[0] else []
    for begin, end in holes:
        left = (
            [
                piece
                for start, stop in left
                for piece in ((start, min(stop, begin)), (max(start, end), stop))
                if piece[1] > piece[0]
            ]
            if end > begin
            else left
        )
    return left


def length(spans: Sequence[Span]) -> float:
    return sum(end - start for start, end in spans)


def of_agent(trial: Trial, agent: int, *, net: bool = True) -> tuple[float, float]:
    """Seconds measured, and seconds of them down. With `net`, the time in which the ground could not have received this
    agent, and one period after it, is not measured.
    """
    span = (trial.began, trial.ended)
    holes = [(start, end + trial.heartbeat_s) for blind, start, end in trial.blind if net and blind == agent]
    watched = without(span, holes)
    heartbeats = trial.heartbeats.get(agent, [])
    overdue = gaps(heartbeats, trial.heartbeat_s, trial.ended) if heartbeats else [span]
    down = [piece for start, end in overdue for piece in without((max(start, span[0]), min(end, span[1])), holes)]
    return length(watched), length(down)


def share(trials: Sequence[Trial], *, net: bool = True) -> float | None:
    """The share of time up, from 0 to 1, over all agents and trials; None when nothing was measured."""
    watched = down = 0.0
    for trial in trials:
        for agent in range(1, trial.agents + 1):
            seconds, overdue = of_agent(trial, agent, net=net)
            watched, down = watched + seconds, down + overdue
    return 1.0 - down / watched if watched > 0 else None
