"""The processes of a container, from the engine's process list.

For each request the engine starts the host's `ps`: measured 13 ms, with 7 ms of CPU time for the engine and 1 ms for
PHM. So it is not polled quickly.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.facts import CannotTell, ProcessFact
from phm.transport.docker import DockerEngine, EngineBroken

LIMIT_S = 1.0
"""A container that hangs in the kernel can block requests about its processes."""
FORMS = ("-ww -o pid,ppid,stat,times,etimes,rss,args", "-o pid,ppid,stat,args")
"""Arguments for `ps`, the best first, not cut to the width of a terminal. The second is for hosts with BusyBox, whose
`ps` reports neither CPU time nor age in seconds, and memory rounded to MB or GB."""
AGAIN_S, AGAIN_MOST_S = 5.0, 300.0
"""A better form that the engine refused is tried again after this time, doubled after each refusal: the engine answers
HTTP 500 both for a `ps` that does not support the form and for one that a busy machine could not start."""
MOST = 1000
_COMMAND_CHARS = 4096
_ENDED = ("Z", "X")


class Processes:
    """Requests process lists in the form that the host's `ps` supports."""

    def __init__(self, engine: DockerEngine, clock: Clock) -> None:
        self._engine, self._clock = engine, clock
        self._best_from, self._backoff = float("-inf"), Backoff(AGAIN_S, AGAIN_MOST_S)

    def inspect(self, container_id: str) -> tuple[ProcessFact, ...]:
        """Raises CannotTell if the container does not run, no response came in time, or it cannot be parsed."""
        best, simple = FORMS
        if self._clock.mono() >= self._best_from:
            try:
                found = processes(self._engine.top(container_id, best, deadline_s=LIMIT_S))
            except EngineBroken:
                found = processes(self._engine.top(container_id, simple, deadline_s=LIMIT_S))
                self._best_from = self._clock.mono() + self._backoff.next_s()
            else:
                self._backoff.reset()
            return found
        return processes(self._engine.top(container_id, simple, deadline_s=LIMIT_S))


def processes(answer: Mapping[str, Any]) -> tuple[ProcessFact, ...]:
    """The facts in a response of the engine; the last column is the command, whatever its name."""
    titles, listed = answer.get("Titles"), answer.get("Processes") or []
    if not isinstance(titles, list) or "PID" not in titles or not all(isinstance(title, str) for title in titles):
        raise CannotTell("the Docker Engine listed processes without process ids")
    if not isinstance(listed, list):
        raise CannotTell("the Docker Engine answered without a process list")
    rows = [row for row in listed if isinstance(row, list) and len(row) == len(titles)]
    found = (_process(dict(zip(titles[:-1], row, strict=False)), str(row[-1])) for row in rows[:MOST])
    return tuple(fact for fact in found if fact.pid and fact.state not in _ENDED)


def _process(row: Mapping[str, Any], command: str) -> ProcessFact:
    resident = _whole(row.get("RSS"))
    return ProcessFact(
        pid=_whole(row.get("PID")) or 0,
        parent=_whole(row.get("PPID")) or 0,
        state=str(row.get("STAT") or "")[:1],
        cpu_s=_whole(row.get("TIME")),
        age_s=_whole(row.get("ELAPSED")),
        memory_bytes=None if resident is None else resident << 10,
        command=command[:_COMMAND_CHARS],
    )


def _whole(text: object) -> int | None:
    words = str(text)
    return int(words) if words.isdecimal() and len(words) < 12 else None
