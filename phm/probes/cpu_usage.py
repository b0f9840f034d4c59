"""Reads CPU usage, and how long tasks waited for CPU, memory and disks."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

from phm.core.clock import Clock
from phm.probes.kernel_file import head

SHORTEST_S = 0.2
"""The kernel counts in hundredths of a second: over a shorter time shares are meaningless, and the last ones are
returned. Before that there are none."""
_IDLE, _IOWAIT, _STEAL = 3, 4, 7
_RUN_DELAY = 8
"""Field of a `cpu` line of /proc/schedstat (Documentation/scheduler/sched-stats.rst): nanoseconds for which tasks
waited."""
_MOST_SCHEDSTAT = 1 << 16


@dataclass(frozen=True, slots=True)
class CpuUsage:
    """Shares since the previous reading. See `phm.facts.HostFact`."""

    busy_percent: float | None = None
    waiting_percent: float | None = None
    memory_percent: float | None = None
    io_percent: float | None = None


@dataclass(frozen=True, slots=True)
class _Reading:
    at: float
    ticks: list[int]
    waited_us: int | None
    memory_us: int | None
    io_us: int | None


class CpuMonitor:
    """Not thread-safe. `proc` is the path of the kernel's /proc."""

    def __init__(self, clock: Clock, proc: Path = Path("/proc")) -> None:
        self._clock, self._proc = clock, str(proc)
        self._last: _Reading | None = None
        self._use = CpuUsage()
        with contextlib.suppress(OSError, ValueError, IndexError):  # `use` reports it
            self.use()  # the first call has no previous reading, so it takes one here

    def use(self) -> CpuUsage:
        """Raises OSError, ValueError or IndexError if the kernel's figures cannot be read."""
        now = self._clock.mono()
        if self._last is not None and now - self._last.at < SHORTEST_S:
            return self._use
        ticks = [int(word) for word in head(f"{self._proc}/stat").split("\n", 1)[0].split()[1 : _STEAL + 2]]
        reading = _Reading(now, ticks, self._waited_us(), self._stalled_us("memory"), self._stalled_us("io"))
        if self._last is not None:
            self._use = _since(self._last, reading)
        self._last = reading
        return self._use

    def _waited_us(self) -> int | None:
        """Microseconds since boot in which a task waited for a core; None if the kernel does not count.

        Without pressure stall information (`psi=0`): the total waiting time of all tasks, per CPU.
        """
        waited_us = self._total_us("cpu", "some")
        return self._run_delay_us() if waited_us is None else waited_us

    def _stalled_us(self, what: str) -> int | None:
        return self._total_us(what, "full")

    def _total_us(self, what: str, kind: str) -> int | None:
        try:
            lines = head(f"{self._proc}/pressure/{what}").splitlines()
            return next((int(line.rpartition("total=")[2]) for line in lines if line.startswith(kind)), None)
        except (OSError, ValueError):
            return None

    def _run_delay_us(self) -> int | None:
        try:
            lines = head(f"{self._proc}/schedstat", _MOST_SCHEDSTAT).splitlines()
            delays_ns = [int(line.split()[_RUN_DELAY]) for line in lines if line.startswith("cpu")]
        except (OSError, ValueError, IndexError):
            return None
        return sum(delays_ns) // 1000 // len(delays_ns) if delays_ns else None


def _since(last: _Reading, new: _Reading) -> CpuUsage:
    spent = [max(0, now - old) for now, old in zip(new.ticks, last.ticks, strict=True)]  # iowait may go back
    total = sum(spent)
    busy = 100.0 * (total - spent[_IDLE] - spent[_IOWAIT]) / total if total else 0.0

    def share(now_us: int | None, old_us: int | None) -> float | None:
        if now_us is None or old_us is None:
            return None
        return min(100.0, max(0.0, (now_us - old_us) / (new.at - last.at) / 1e4))

    return CpuUsage(
        busy,
        share(new.waited_us, last.waited_us),
        share(new.memory_us, last.memory_us),
        share(new.io_us, last.io_us),
    )
