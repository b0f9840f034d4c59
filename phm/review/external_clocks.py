"""The clocks of other people's records, by the lines of PHM in them: an autopilot logs the lines that it receives from PHM, and a
recording of ROS 2 has PHM's diagnostics.

PHM's own log says when it had each of these lines to say. Lines about changes that both have are votes for an offset, which needs
the evidence of `votes`, as for the clocks of agents; then all lines are paired in order, and the offset is the median of those about
changes. The regular status lines count and widen the error, but are sent some tenths of a second after their report. A line arrives
after it was written, never before: so the offset is too small by the usual delay of the link.
"""

from __future__ import annotations

import itertools
import re
import statistics
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from phm.core.model import Level, Slot
from phm.review.agent_run import Run
from phm.review.clocks import RunClock
from phm.review.events import WORDS
from phm.review.external_entry import LEVELS, ExternalEntry
from phm.review.spans import Span, both, joined
from phm.review.votes import OWN_ERROR_S, WINDOW_S, Key, Times, candidate, compared, too_little, weigh, within
from phm.wire import status_line

LEAST_LINES, LEAST_CHANGES = 3, 2
"""This many lines must agree, and this many of them must be about changes: regular lines come at even intervals and fit many offsets."""
MOST_VOTES = 200_000
BY = "lines or diagnostics of PHM that are also in its log"
NO_LINES = "its own clock: it has no line and no diagnostic about a change that is also in PHM's log"
SEVERAL = "its own clock: the lines and diagnostics that are also in PHM's log fit several offsets"
_LINE = re.compile(r"A(\d{1,3}) ([A-Z]+) (?:([01-]{8})(?: |$)|(\d{1,2}) )")
_STATUS = re.compile(r"phm/[^/:]+/\w+: (.+?): ")
REFRESH, UNIT = "regular", "unit"
SLOTS = frozenset(each.value for each in Slot)


@dataclass(frozen=True)
class ExternalClock:
    """offset_s: was added to all times of the file to get the reference's; None: unknown. error_s: how wrong that may be. lines: how
    many lines of PHM agree. by: what it is derived from, or why it is not."""

    file: str
    offset_s: float | None = None
    error_s: float | None = None
    lines: int = 0
    by: str = NO_LINES
    placed: bool = True
    """False: the file does not say when it was made, and the offset is from its boot."""


@dataclass(frozen=True)
class _Log:
    """What PHM's own logs say, on the reference's time. said: lines and diagnostics; covers: by agent, when it wrote; failing: by
    subject, from when to when it failed."""

    said: Times
    covers: Mapping[object, Sequence[Span]]
    failing: Mapping[Key, Sequence[Span]]


def align_external(
    others: Iterable[ExternalEntry], runs: Sequence[tuple[Run, RunClock]]
) -> tuple[list[ExternalEntry], list[ExternalClock]]:
    """The entries with the reference's times in the order of time, and the clock of each file. runs: with their clocks.

    Entries of a file that does not say when it was made, and of which PHM's lines do not say it either, are left out.
    """
    by_file: dict[str, list[ExternalEntry]] = {}
    for other in others:
        by_file.setdefault(other.file, []).append(other)
    if not by_file:
        return [], []
    log = _Log(_sorted(_said(runs)), _covers(runs), _failing(runs))
    moved: list[ExternalEntry] = []
    clocks: list[ExternalClock] = []
    for file, entries in sorted(by_file.items()):
        span = [min(one.t for one in entries), max(one.t for one in entries)]
        clock = replace(_clock(file, _sorted(_received(entries)), span, log), placed=all(one.placed for one in entries))
        clocks.append(clock)
        offset_s = clock.offset_s
        if offset_s is None and not clock.placed:
            continue
        moved += entries if offset_s is None else (one._replace(t=one.t + offset_s) for one in entries)
    return sorted(moved), clocks


def _clock(file: str, received: Times, span: Span, log: _Log) -> ExternalClock:
    differences = list(itertools.islice(_differences(received, log.said), MOST_VOTES))
    agreed = candidate(differences)
    if agreed is None:
        return ExternalClock(file, by=SEVERAL if differences else NO_LINES)
    pairs = {key: _paired(times, log.said.get(key, ()), agreed[0]) for key, times in received.items()}
    every = [difference for found in pairs.values() for difference in found]
    changes = [difference for key, found in pairs.items() if key[-1] != REFRESH for difference in found]
    few = f"its own clock: {len(changes)} lines about changes and {len(every) - len(changes)} regular ones agree with PHM's log"
    if len(every) < LEAST_LINES or len(changes) < LEAST_CHANGES:
        return ExternalClock(
            file, lines=len(every), by=f"{few}; {LEAST_LINES} lines are needed, {LEAST_CHANGES} of them about changes"
        )
    if why := _refused(received, span, log, agreed[0]):
        return ExternalClock(
            file, lines=len(every), by=f"its own clock: of the lines about changes that are also in PHM's log, {why}"
        )
    offset_s = statistics.median(changes)
    spread_s = max(max(every) - offset_s, offset_s - min(every))
    return ExternalClock(file, offset_s, spread_s + OWN_ERROR_S, len(every), BY)


def _refused(received: Times, span: Span, log: _Log, offset_s: float) -> str:
    """Why the evidence is not enough for this offset; empty if it is. span: of all entries of the file."""
    begin, end = span[0] + offset_s, span[1] + offset_s
    changes = {key: times for key, times in received.items() if key[-1] != REFRESH}
    sources = {_source(key) for key in received}
    said = {
        key: times[bisect_left(times, begin + WINDOW_S) : bisect_right(times, end - WINDOW_S)]
        for key, times in log.said.items()
        if key[-1] != REFRESH and _source(key) in sources
    }

    def logged(key: Key, at: float) -> bool:
        """What still fails is said again, in other words too: the log has no new line of that."""
        again = within(log.failing.get(_subject(key), ()), at)
        return within(log.covers.get(key[0], ()), at, WINDOW_S) and not again

    own = joined(one for agent in {key[0] for key in received} for one in log.covers.get(agent, ()))
    theirs = weigh(changes, log.said, offset_s, logged, _subject)
    mine = weigh(said, changes, -offset_s, lambda key, at: True, _subject)
    return too_little(offset_s, mine, theirs, overlapping=bool(both(own, [span])))


def _source(key: Key) -> tuple[object, bool]:
    """Agent, and whether it is a diagnostic: a file may have only one of both."""
    return key[0], key[1] == UNIT


def _subject(key: Key) -> Key:
    """What the line is about: agent and slot, or agent and unit."""
    return key[:3] if key[1] == UNIT else key[:2]


def _differences(received: Times, said: Times) -> Iterator[float]:
    """Of lines about changes that both have; the rarest first, which say most."""
    both = [key for key in received.keys() & said.keys() if key[-1] != REFRESH]
    for key in sorted(both, key=lambda key: (len(received[key]) * len(said[key]), repr(key))):
        yield from (ours - theirs for theirs, ours in compared(received[key], said[key]))


def _paired(theirs: Sequence[float], ours: Sequence[float], offset_s: float) -> list[float]:
    """Differences of times that belong together, each used once, in order."""
    found, place = list[float](), 0
    for t in theirs:
        while place < len(ours) and ours[place] - t < offset_s - WINDOW_S:
            place += 1
        if place < len(ours) and ours[place] - t <= offset_s + WINDOW_S:
            found.append(ours[place] - t)
            place += 1
    return found


def _said(runs: Sequence[tuple[Run, RunClock]]) -> Iterator[tuple[Key, float]]:
    """The times at which PHM wrote its lines, by its log."""
    for run, clock in runs:
        for change in run.changes:
            if change.text_only:
                continue
            shown = change.level if change.level in LEVELS else ""
            yield (run.agent_id, UNIT, change.unit, shown), clock.t(change.mono)
            slot = run.units.get(change.unit, {}).get("slot")
            if slot not in SLOTS:
                continue
            if change.level in ("ERROR", "WARN"):
                text = status_line.failing(run.agent_id, Level[change.level], Slot(slot), change.brief or change.unit)
                yield (run.agent_id, slot, text), clock.t(change.mono)
            elif change.level == "OK" and change.old in ("ERROR", "WARN"):
                yield (run.agent_id, slot, "OK"), clock.t(change.mono)
        for mono in run.reports:
            yield (run.agent_id, REFRESH), clock.t(mono)


def _covers(runs: Sequence[tuple[Run, RunClock]]) -> dict[object, list[Span]]:
    found: dict[object, list[Span]] = {}
    for run, clock in runs:
        found.setdefault(run.agent_id, []).extend([clock.t(begin), clock.t(end)] for begin, end in run.cover.spans)
    return {agent: joined(spans) for agent, spans in found.items()}


def _failing(runs: Sequence[tuple[Run, RunClock]]) -> dict[Key, list[Span]]:
    found: dict[Key, list[Span]] = {}
    for run, clock in runs:
        since: dict[str, float] = {}
        for change in run.changes:
            if change.level in ("ERROR", "WARN"):
                since.setdefault(change.unit, clock.t(change.mono))
            elif change.unit in since:
                _fails(found, run, change.unit, [since.pop(change.unit), clock.t(change.mono)])
        end = max((clock.t(span[1]) for span in run.cover.spans), default=0.0)
        for unit, begin in since.items():
            _fails(found, run, unit, [begin, max(begin, end)])
    return {subject: joined(spans) for subject, spans in found.items()}


def _fails(found: dict[Key, list[Span]], run: Run, unit: str, span: Span) -> None:
    for subject in ((run.agent_id, UNIT, unit), (run.agent_id, run.units.get(unit, {}).get("slot"))):
        found.setdefault(subject, []).append(span)


def _received(entries: Iterable[ExternalEntry]) -> Iterator[tuple[Key, float]]:
    for other in entries:
        if other.what == "diagnostic" and (status := _STATUS.match(other.text)):
            yield (other.system, UNIT, status[1], other.level), other.t
        line = _LINE.match(other.text) if other.what == "statustext" else None
        if line is None:
            continue
        agent, word, array, slot = int(line[1]), line[2], line[3], line[4]
        if array:
            yield (agent, REFRESH), other.t
        elif word == "OK":
            yield (agent, int(slot), "OK"), other.t
        elif word in WORDS:
            yield (agent, int(slot), other.text), other.t


def _sorted(pairs: Iterable[tuple[Key, float]]) -> dict[Key, list[float]]:
    found: dict[Key, list[float]] = {}
    for key, t in pairs:
        found.setdefault(key, []).append(t)
    for times in found.values():
        times.sort()
    return found
