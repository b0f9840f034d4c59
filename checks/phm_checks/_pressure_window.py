"""What the counters of a container show about the last seconds.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from phm import api

LEAST_S = 0.4
"""Over a shorter time, shares mean nothing: the kernel grants the CPU limit in ten periods per second."""
MOST_READINGS = 200
PAGE_S = 0.01
"""Reading a page back takes at most this long, also from an SD card; if it takes longer, the disk is what is slow."""


@dataclass(frozen=True, slots=True)
class PressureDelta:
    """What happened to a container in `seconds`. Shares are in percent of that time; None: not available.

    memory: waiting for memory by the kernel's measure. shortage: the part of it that more memory would end, see `_shortage`.
    """

    seconds: float
    cpus: float | None = None
    throttled: float | None = None
    waiting: float | None = None
    memory: float | None = None
    shortage: float | None = None
    io: float | None = None
    faults_hz: float | None = None
    oom_kills: int = 0
    memory_limit_hits: int | None = None
    refused: int = 0


class PressureWindow:
    """The readings of one container generation."""

    def __init__(self, longest_s: float) -> None:
        self._longest_s = longest_s
        self._facts: deque[api.PressureFact] = deque(maxlen=MOST_READINGS)

    def add(self, fact: api.PressureFact) -> None:
        """Add a reading. A repeated reading counts once; a reading from another generation or source discards all earlier ones."""
        if self._facts and _other(self._facts[-1], fact):
            self._facts.clear()
        if self._facts and fact.at - self._facts[-1].at < LEAST_S / 2:
            return
        self._facts.append(fact)
        while len(self._facts) > 2 and self._facts[1].at <= fact.at - self._longest_s:
            self._facts.popleft()

    def forget(self) -> None:
        self._facts.clear()

    def over(self, span_s: float, *, full: bool = False) -> PressureDelta | None:
        """The change over the last `span_s` seconds or a little more; None while there are too few readings to compare.

        full: also return None while the readings do not reach back that far.
        """
        if not self._facts:
            return None
        new = self._facts[-1]
        old = next((fact for fact in reversed(self._facts) if fact.at <= new.at - span_s), self._facts[0])
        seconds = new.at - old.at
        if seconds < LEAST_S or (full and seconds < 0.95 * span_s):
            return None
        return _spent(old, new, seconds)


def _other(old: api.PressureFact, new: api.PressureFact) -> bool:
    return (old.generation, old.source) != (new.generation, new.source) or new.at < old.at or _backwards(old, new)


def _backwards(old: api.PressureFact, new: api.PressureFact) -> bool:
    return old.cpu_used_s is not None and new.cpu_used_s is not None and new.cpu_used_s < old.cpu_used_s


def _spent(old: api.PressureFact, new: api.PressureFact, seconds: float) -> PressureDelta:
    throttled = _throttled(old, new, seconds)
    waiting = _share(old.cpu, new.cpu, seconds)
    used_s = _risen(old.cpu_used_s, new.cpu_used_s)
    faults = _risen(old.reread_pages, new.reread_pages)
    memory, io = _share(old.memory, new.memory, seconds), _share(old.io, new.io, seconds)
    limited, hits = new.memory_limit is not None, _risen(old.memory_limit_hits, new.memory_limit_hits)
    return PressureDelta(
        seconds,
        cpus=None if used_s is None else used_s / seconds,
        throttled=throttled,
        # The kernel counts tasks that the limit throttles among those that wait for a CPU.
        waiting=None if waiting is None else max(0.0, waiting - (throttled or 0.0)),
        memory=memory,
        shortage=_shortage(memory, io or 0.0, waiting or 0.0, (faults or 0.0) / seconds) if limited else memory,
        io=io,
        faults_hz=None if faults is None else faults / seconds,
        oom_kills=int(_risen(old.oom_kills, new.oom_kills) or 0),
        memory_limit_hits=None if hits is None else int(hits),
        refused=int(_risen(old.pids_refused, new.pids_refused) or 0),
    )


def _throttled(old: api.PressureFact, new: api.PressureFact, seconds: float) -> float | None:
    """Percent of the time in which the limit kept the container from running; 0 without a limit.

    The share of periods in which the limit was used up is not enough: it would report a container as starved that needs 1 % more CPU
    time than it gets. So it is multiplied by the share of the required CPU time that was refused. This is correct for any number of
    CPUs, since the throttled time is summed over all of them.
    """
    hits, stopped_s = _risen(old.throttled_periods, new.throttled_periods), _risen(old.throttled_s, new.throttled_s)
    used_s = _risen(old.cpu_used_s, new.cpu_used_s)
    if new.cpu_limit is None and hits is not None:
        return 0.0
    if hits is None or stopped_s is None or used_s is None:
        return None
    wanted_s = stopped_s + used_s
    return 100.0 * min(1.0, hits * new.cpu_period_s / seconds) * stopped_s / wanted_s if wanted_s > 0 else 0.0


def _shortage(memory: float | None, io: float, waiting: float, faults_hz: float) -> float | None:
    """Percent of the time in which a container with a memory limit waits because of the limit.

    To the kernel, a task that makes memory free waits for memory, also while it waits for the disk (until its own data have been
    written, or a page has been brought back) or for a CPU. Of these, only the page that is brought back is for lack of memory: a
    recorder at its limit waits for the disk.
    """
    if memory is None:
        return None
    return max(0.0, memory - max(0.0, io - 100.0 * PAGE_S * faults_hz) - waiting)


def _share(old: api.StallFact | None, new: api.StallFact | None, seconds: float) -> float | None:
    if old is None or new is None or old.full_s is None or new.full_s is None:
        return None
    return min(100.0, max(0.0, 100.0 * (new.full_s - old.full_s) / seconds))


def _risen(old: float | None, new: float | None) -> float | None:
    return None if old is None or new is None else max(0.0, new - old)
