"""The process whose memory grows while the memory of its container fills.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from phm import api
from phm_checks._process_matching import match, wanted_nodes
from phm_checks._text import clean, last, listed

STEP_BYTES = 4 << 20
"""The processes are listed again once the container should have grown by this, which is far more than the kernel's counters of memory
lag behind, but LEAST_S later at the earliest and MOST_S later at the latest. Each time this takes twice as long as before."""
LEAST_S, MOST_S = 5.0, 60.0
LEAST_BYTES, TYPICAL = 1 << 20, 2.0
"""Lists are compared once the container has grown by this since the first one, and by half to twice of what is forecast: what comes and
goes is not the leak."""
MOST_OF_IT, MORE_THAN_IT = 0.5, 2.0
"""A process is named if it alone has grown by more than MOST_OF_IT of what its container has grown by. Two such processes share memory;
one that has grown by MORE_THAN_IT maps a file, which is page cache and no leak. The engine's statistics, where PHM has no cgroups, are
up to 2 s old: an error of less than this after LEAST_S."""


@dataclass(frozen=True, slots=True)
class Grower:
    """The process. words: its node, if known, and its number on the host; short: its name for a brief."""

    words: str
    short: str


@dataclass(frozen=True, slots=True)
class _Reading:
    """The container's memory in bytes, and its processes by their numbers at about the same time (monotonic seconds)."""

    at: float
    used: int
    processes: Mapping[int, api.ProcessFact]


class GrowingProcess:
    """Asks the engine for process lists, only between the first `observe` and `forget`."""

    def __init__(self, key: str, settings: api.Settings) -> None:
        self._key = key
        self._nodes = [node for node in wanted_nodes(settings) if node.container == key]
        self._permitted = True
        self.forget()

    def forget(self) -> None:
        """Start again: nothing is forecast, or the container has other processes."""
        self._first: _Reading | None = None
        self._found: Grower | None = None
        self._due_at, self._wait_s = float("-inf"), 0.0

    def observe(self, world: api.World, used: int, slope: float) -> Grower | None:
        """The process that has most of the container's growth; None if no process has, or that is not known yet.

        used: the container's memory in bytes without the page cache. slope: its growth in bytes per second.
        """
        now = world.clock.mono()
        if not self._permitted or now < self._due_at:
            return self._found
        first_s = min(max(STEP_BYTES / slope, LEAST_S), MOST_S)
        self._wait_s = min(2 * self._wait_s, MOST_S) if self._wait_s else first_s
        try:
            listed_now = world.docker.processes(self._key)
        except api.NotPermitted:
            self._permitted, self._found = False, None
            return None
        except api.CannotTell:
            return self._found
        finally:
            self._due_at = world.clock.mono() + self._wait_s
        newest = _Reading(now, used, {fact.pid: fact for fact in listed_now if fact.memory_bytes is not None})
        if self._first is None:
            self._first = newest
        elif _is_typical(self._first, newest, slope):
            self._compare(self._first, newest, listed_now)
        return self._found

    def _compare(self, first: _Reading, newest: _Reading, every: Sequence[api.ProcessFact]) -> None:
        grown = newest.used - first.used
        shares = {pid: by / grown for pid, by in _growth(first, newest).items() if by > MOST_OF_IT * grown}
        if len(shares) == 1 and max(shares.values()) < MORE_THAN_IT:
            (pid,) = shares
            self._found = self._describe(newest.processes[pid], every)
        else:
            # A process that was started later is in the newest list alone: that is compared with the next one.
            self._first, self._found = newest, None

    def _describe(self, process: api.ProcessFact, every: Sequence[api.ProcessFact]) -> Grower:
        """Of the command line only the program's name is shown: its arguments may contain a password."""
        matched, _ = match(self._nodes, every, {})
        names = sorted(name for name, found in matched.items() if found.process.pid == process.pid)
        program = clean(last(process.command.partition(" ")[0]), 40)
        if not names:
            return Grower(f"process {process.pid}{f' ({program})' if program else ''}", program)
        what = "node" if len(names) == 1 else "nodes"
        return Grower(
            f"{what} {listed(names, 3)} (process {process.pid})", last(names[0]) if len(names) == 1 else program
        )


def _is_typical(first: _Reading, newest: _Reading, slope: float) -> bool:
    """Whether the container has grown enough between the two, and about as fast as forecast."""
    grown, forecast = newest.used - first.used, slope * (newest.at - first.at)
    return grown >= LEAST_BYTES and forecast / TYPICAL <= grown <= forecast * TYPICAL


def _growth(first: _Reading, newest: _Reading) -> dict[int, int]:
    """How much the memory of each process has grown, in bytes. A number may meanwhile belong to another process."""
    return {
        pid: (fact.memory_bytes or 0) - (before.memory_bytes or 0)
        for pid, fact in newest.processes.items()
        if (before := first.processes.get(pid)) is not None and before.command == fact.command
    }
