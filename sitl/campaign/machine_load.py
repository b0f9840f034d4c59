"""Measures the load of the machine that all agents share, so that their alarms about it can be confirmed."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import psutil

from sitl.campaign.host_load import BEFORE_S
from sitl.campaign.observer_thread import ObserverThread
from sitl.campaign.trial import Load

PERIOD_S = 0.5
"""Windows of PHM begin at other moments than samples, so a sample must be short beside them (`sitl.campaign.host_load`)."""
IO_PRESSURE = Path("/proc/pressure/io")


class MachineMeter:
    """Samples every PERIOD_S between `start` and `stop`, in a thread. The samples remain."""

    def __init__(self, io_pressure: Path = IO_PRESSURE) -> None:
        self._io_pressure = io_pressure
        thread = ObserverThread("machine-load", self._run, 2 * PERIOD_S)
        self.start, self.stop = thread.start, thread.stop
        self._lock = threading.Lock()
        self._samples: list[Load] = []

    def begin(self) -> None:
        """A trial begins: drop what is too old to matter for it."""
        since = time.monotonic() - BEFORE_S
        with self._lock:
            self._samples = [each for each in self._samples if each.mono >= since]

    def samples(self) -> list[Load]:
        """Since shortly before `begin`: an alarm at the beginning may be about the load before it."""
        with self._lock:
            return list(self._samples)

    def _run(self, ending: threading.Event) -> None:
        psutil.cpu_percent()
        while not ending.wait(PERIOD_S):
            found = sample(self._io_pressure)
            with self._lock:
                self._samples.append(found)


def sample(io_pressure: Path = IO_PRESSURE) -> Load:
    """The load now; the CPU in use since the call before."""
    return Load(
        mono=time.monotonic(),
        cpu=psutil.cpu_percent(),
        memory=psutil.virtual_memory().percent,
        disk=psutil.disk_usage("/").percent,
        io_stalled=_stalled(io_pressure),
    )


def _stalled(file: Path) -> float | None:
    """The share of the last 10 s in which all tasks waited, as the kernel computes it."""
    try:
        lines = file.read_text("ascii").splitlines()
    except OSError:
        return None
    for line in lines:
        kind, *pairs = line.split()
        found = dict(pair.split("=", 1) for pair in pairs)
        if kind == "full" and "avg10" in found:
            return float(found["avg10"])
    return None
