"""The share of time that PHM was up, as seen by a ground station. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from sitl.campaign.trial import Trial

JITTER = 0.1
"""A heartbeat that is later than its period by more than this share of it is overdue; one lost frame makes a gap, too."""

Span = tuple[float, float]


def gaps(times: Sequence[float], period_s: float, ended: float) -> list[Span]:
    """When the heartbeat was overdue: from its due time to its arrival, or to the end of the measurement."""
    pauses = pairwise([*sorted(times), ended])
    return [(start + period_s, end) for start, end in pauses if end - start > (1 + JITTER) * period_s]


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


def outages(trial: Trial, agent: int) -> list[Span]:
    """Known outages, which may fit between two heartbeats: from the injection of a fault that affects PHM itself, and
    from the last heartbeat before a start of PHM, each until the next heartbeat arrives.
    """
    heartbeats = sorted(trial.heartbeats.get(agent, []))

    def until(mono: float) -> float:
        return next((heartbeat for heartbeat in heartbeats if heartbeat >= mono), trial.ended)

    injected = [
        each.moment for each in trial.injections if each.phm and each.agent == agent and each.moment is not None
    ]
    found = [(moment, until(moment)) for moment in injected]
    for start in (each.mono for each in trial.starts if each.agent == agent):
        before = [heartbeat for heartbeat in heartbeats if heartbeat < start]
        last = before[-1] if before else trial.began
        found.append((next((moment for moment in injected if last <= moment <= start), last), until(start)))
    return found


def of_agent(trial: Trial, agent: int, *, net: bool = True) -> tuple[float, float]:
    """Seconds measured, and seconds of them down. With `net`, the time in which the ground could not have received this
    agent, and one period after it, is not measured.
    """
    span = (trial.began, trial.ended)
    holes = [(start, end + trial.heartbeat_s) for blind, start, end in trial.blind if net and blind == agent]
    watched = without(span, holes)
    heartbeats = trial.heartbeats.get(agent, [])
    overdue = gaps(heartbeats, trial.heartbeat_s, trial.ended) if heartbeats else [span]
    up = watched
    for start, end in (*overdue, *outages(trial, agent)):
        up = [piece for each in up for piece in without(each, [(start, end)])]
    return length(watched), length(watched) - length(up)


def share(trials: Sequence[Trial], *, net: bool = True) -> float | None:
    """The share of time up, from 0 to 1, over all agents and trials; None when nothing was measured."""
    watched = down = 0.0
    for trial in trials:
        for agent in range(1, trial.agents + 1):
            seconds, overdue = of_agent(trial, agent, net=net)
            watched, down = watched + seconds, down + overdue
    return 1.0 - down / watched if watched > 0 else None
