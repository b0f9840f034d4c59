"""Reads how much of the processor is in use, and how long tasks had to wait for it."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from phm.clock import Clock

SHORTEST_S = 0.2
"""The kernel counts in hundredths of a second: over less than this, shares say nothing, and the last ones are given."""
_HEAD_BYTES = 1024
_IDLE, _IOWAIT, _STEAL = 3, 4, 7


@dataclass(frozen=True, slots=True)
class Use:
    """Shares since the reading before. See `phm.facts.HostFact`."""

    busy_percent: float
    waiting_percent: float | None


class Processor:
    """Not thread-safe. `proc` is where the kernel's /proc is."""

    def __init__(self, clock: Clock, proc: Path = Path("/proc")) -> None:
        self._clock = clock
        self._stat, self._pressure = str(proc / "stat"), str(proc / "pressure" / "cpu")
        self._last: tuple[float, list[int], int | None] | None = None
        self._use = Use(0.0, None)
        with contextlib.suppress(OSError, ValueError, IndexError):  # whoever asks is told
            self.use()  # the first reading has nothing to compare with, so it is taken here

    def use(self) -> Use:
        """Raises OSError, ValueError or IndexError when the kernel's figures cannot be read."""
        now = self._clock.mono()
        if self._last is not None and now - self._last[0] < SHORTEST_S:
            return self._use
        ticks = [int(word) for word in head(self._stat).split("\n", 1)[0].split()[1 : _STEAL + 2]]
        waited_us = self._waited_us()
        if self._last is not None:
            self._use = self._since(self._last, now, ticks, waited_us)
        self._last = now, ticks, waited_us
        return self._use

    @staticmethod
    def _since(last: tuple[float, list[int], int | None], now: float, ticks: list[int], waited_us: int | None) -> Use:
        spent = [max(0, new - old) for new, old in zip(ticks, last[1], strict=True)]  # iowait may go back
        total = sum(spent)
        busy = 100.0 * (total - spent[_IDLE] - spent[_IOWAIT]) / total if total else 0.0
        if waited_us is None or last[2] is None:
            return Use(busy, None)
        return Use(busy, min(100.0, max(0.0, (waited_us - last[2]) / (now - last[0]) / 1e4)))

    def _waited_us(self) -> int | None:
        """Microseconds since boot in which some task waited for a core; None where the kernel does not count (`psi=0`)."""
        try:
            return int(head(self._pressure).split("\n", 1)[0].rpartition("total=")[2])
        except (OSError, ValueError):
            return None


def head(path: str) -> str:
    """The first lines of a file of the kernel, whole or not."""
    number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(number, _HEAD_BYTES).decode("ascii", "replace")
    finally:
        os.close(number)
