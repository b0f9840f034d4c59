"""Levels over time: of each unit, and the worst of an agent. A segment is (begin, end, level); where PHM did not run is none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from phm.review.agent_record import AgentRecord
from phm.review.ground_part import GroundRun
from phm.review.record import Record
from phm.review.spans import Span, clipped, joined, without

Segment = tuple[float, float, str]
RANK = ("ERROR", "WARN", "STALE", "OK")
"""The first of these that a unit has is the agent's level. `n/a` does not count."""


def of_units(agent: AgentRecord) -> dict[str, list[Segment]]:
    """Each unit's levels, from the first line about it in a run to the end of the run."""
    found: dict[str, list[Segment]] = {}
    for run, clock in agent.runs:
        cover = [[clock.t(begin), clock.t(end)] for begin, end in run.cover.spans]
        points: dict[str, list[tuple[float, str]]] = {
            unit: [(clock.t(body["at"]), body["level"])] for unit, body in run.units.items()
        }
        for change in run.levels():
            if change.unit in points and change.level != points[change.unit][-1][1]:
                points[change.unit].append((clock.t(change.mono), change.level))
        end = cover[-1][1] if cover else 0.0
        for unit, known in points.items():
            segments = found.setdefault(unit, [])
            for place, (t, level) in enumerate(known):
                until = known[place + 1][0] if place + 1 < len(known) else end
                segments += (
                    [(begin, stop, level) for begin, stop in clipped([[t, until]], *_outer(cover))] if until > t else []
                )
    return {unit: _cut(segments, agent.cover) for unit, segments in found.items()}


def of_agent(units: Iterable[Sequence[Segment]], cover: Sequence[Span], rank: Sequence[str] = RANK) -> list[Segment]:
    """The worst level of all units at each moment: the first one in `rank`."""
    edges: list[tuple[float, int, str]] = []
    for segments in units:
        for begin, end, level in segments:
            if level in RANK:
                edges += [(begin, 1, level), (end, -1, level)]
    edges.sort(key=lambda edge: edge[0])
    counts: Counter[str] = Counter()
    result: list[Segment] = []
    since, level = 0.0, ""
    for t, step, name in edges:
        counts[name] += step
        worst = next((each for each in rank if counts[each] > 0), "")
        if worst == level:
            continue
        if level and t > since:
            result.append((since, t, level))
        since, level = t, worst
    return _cut(_joined(result), cover)


def of_ground(record: Record, agent: int) -> list[Segment]:
    """An agent's worst level as the ground received it, for agents without a log; none in the gaps. Of several that recorded at the
    same time the worst at each moment."""
    found: list[list[Segment]] = []
    for ground, clock in record.grounds:
        result: list[Segment] = []
        known = [(clock.t(mono), level) for mono, level in _received(ground, agent)]
        end = clock.t(ground.cover.spans[-1][1]) if ground.cover.spans else 0.0
        for place, (t, level) in enumerate(known):
            until = known[place + 1][0] if place + 1 < len(known) else end
            if level and until > t:
                result.append((t, until, level))
        found.append(result)
    return of_agent(found, joined([segment[:2] for result in found for segment in result]))


def _received(ground: GroundRun, agent: int) -> list[tuple[float, str]]:
    """Each moment on the ground's clock at which the level changed; empty: not received."""
    lines = [(mono, 1, level, 0.0) for mono, which, level in ground.levels if which == agent]
    # One heartbeat can cause two lines: the levels of the first one after a gap are newer than `alive`, and those of the last
    # one before the agent leaves do not last.
    lines += [
        (mono, 0 if presence == "alive" else 2, presence, silent_s)
        for mono, which, presence, silent_s in ground.presence
        if which == agent
    ]
    found: list[tuple[float, str]] = []
    last = ""
    for mono, order, word, silent_s in sorted(lines):
        if order == 1:
            last = word
        if order < 2:
            found.append((mono, last))  # at `alive` the last one: the ground records only levels that change
        else:
            heard = mono - silent_s if word == "lost" else mono
            found.append((max(heard, found[-1][0]) if found else heard, ""))
    return found


def gaps(record: Record, agent: int) -> list[Span]:
    """When no ground that recorded received the agent: from its last heartbeat to the next one."""
    found: list[Span] = []
    received: list[Span] = []
    for ground, clock in record.grounds:
        lost: float | None = None
        there: float | None = None
        for mono, which, presence, silent_s in ground.presence:
            if which != agent:
                continue
            t = clock.t(mono) - (silent_s if presence == "lost" else 0.0)
            if presence != "alive" and there is not None:
                received.append([there, t])
                there = None
            elif presence == "alive" and there is None:
                there = t
            if presence == "lost":
                lost = t
            elif lost is not None:
                found.append([lost, t])
                lost = None
        end = clock.t(ground.cover.spans[-1][1]) if ground.cover.spans else 0.0
        found += [[lost, end]] if lost is not None else []
        received += [[there, end]] if there is not None else []
    return without(found, received)


def seconds(segments: Iterable[Segment], begin: float, end: float) -> dict[str, float]:
    """The seconds in each level between begin and end."""
    found: dict[str, float] = {}
    for first, last, level in segments:
        length = min(last, end) - max(first, begin)
        if length > 0:
            found[level] = found.get(level, 0.0) + length
    return found


def shortened(segments: Sequence[Segment], most: int) -> tuple[list[Segment], float]:
    """At most `most` segments for a drawing, and the seconds within which some were joined (0: none was).

    Neighbours that are shorter than half of these seconds become one, with the worst of their levels: no time is lost, and none
    looks better than it was. Times in which PHM did not run stay, unless they alone are more than `most`.
    """
    if len(segments) <= most:
        return list(segments), 0.0
    whole = segments[-1][1] - segments[0][0]
    least, near = whole / most / 16, 1e-6
    while len(kept := _grouped(segments, least, near)) > most:
        least *= 1.5
        if least > whole:
            near = max(2 * near, whole / most)
    return kept, 2 * least


def _grouped(segments: Sequence[Segment], least: float, near: float) -> list[Segment]:
    result: list[Segment] = []
    for begin, end, level in segments:
        if result and begin - result[-1][1] <= near:
            first, last, had = result[-1]
            if last - first < least and end - begin < least:
                result[-1] = (first, max(last, end), min(had, level, key=_rank))
                continue
        result.append((begin, end, level))
    return result


def _rank(level: str) -> int:
    return RANK.index(level) if level in RANK else len(RANK)


def _outer(cover: Sequence[Span]) -> tuple[float, float]:
    return (cover[0][0], cover[-1][1]) if cover else (0.0, 0.0)


def _cut(segments: Iterable[Segment], cover: Sequence[Span]) -> list[Segment]:
    """Without the times in which PHM did not run. Both ascend, so that each span is looked at one time."""
    result: list[Segment] = []
    place = 0
    for begin, end, level in sorted(segments):
        while place < len(cover) and cover[place][1] <= begin:
            place += 1
        here = place
        while here < len(cover) and cover[here][0] < end:
            result.append((max(begin, cover[here][0]), min(end, cover[here][1]), level))
            here += 1
    return result


def _joined(segments: Sequence[Segment]) -> list[Segment]:
    result: list[Segment] = []
    for begin, end, level in segments:
        if result and result[-1][2] == level and begin <= result[-1][1] + 1e-6:
            result[-1] = (result[-1][0], max(result[-1][1], end), level)
        else:
            result.append((begin, end, level))
    return result
