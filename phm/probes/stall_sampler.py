"""Has the kernel count exactly how long a container waits for a CPU, while it seems to wait.

The kernel counts the waiting time on each CPU and adds it up when `cpu.pressure` is read, at the latest after 2 s. The sum is a mean
in which each CPU has the weight of the time in which the container had a task there (`collect_percpu_times` in kernel/sched/psi.c).
If its tasks changed their CPU meanwhile, too little is counted: for a container that waits all the time, 50 to 90 % on two CPUs, and
as little as 25 % is possible on four. The more often the file is read, the shorter is the time in which tasks can change their CPU.
Read ten times a second, it was 88 to 98 %.
"""

from __future__ import annotations

import contextlib
import threading

from phm.core import threads
from phm.core.clock import Clock
from phm.probes.kernel_file import head

PERIOD_S = 0.1
SUSPECT = 0.15
"""From this share of waiting on, by the kernel's count: on four CPUs it may be most of the time."""
KEEP_S = 3.0
"""A file is read for this long after the last suspicion, and the thread then ends."""
MOST_FILES = 32


class StallSampler:
    """Reads the pressure files of containers that seem to wait for a CPU. Thread-safe. Has a thread while there are any."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._until: dict[str, float] = {}
        self._lock = threading.Lock()
        self._sampling = False
        self._never = threading.Event()

    def suspect(self, path: str) -> None:
        """Read this file frequently from now on, for KEEP_S."""
        with self._lock:
            if path not in self._until and len(self._until) >= MOST_FILES:
                return
            self._until[path] = self._clock.mono() + KEEP_S
            if not self._sampling:
                self._sampling = threads.start_now(
                    threading.Thread(target=self._sample, name="phm-stalls", daemon=True)
                )

    def _sample(self) -> None:
        while paths := self._due():
            for path in paths:
                with contextlib.suppress(OSError):  # the container has ended
                    head(path, 1)
            self._clock.wait(self._never, PERIOD_S)

    def _due(self) -> tuple[str, ...]:
        """The files to read; empty: the thread ends."""
        with self._lock:
            now = self._clock.mono()
            self._until = {path: until for path, until in self._until.items() if now < until}
            self._sampling = bool(self._until)
            return tuple(self._until)
