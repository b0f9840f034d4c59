"""Measures the load of the machine that all agents share, so that their alarms about it can be confirmed."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import psutil

from sitl.campaign.trial import Load

PERIOD_S = 1.0
IO_PRESSURE = Path("/proc/pressure/io")


class MachineMeter:
    """Samples once a second between `begin` and `end`, in a thread."""

    def __init__(self, io_pressure: Path = IO_PRESSURE) -> None:
        self._io_pressure = io_pressure
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._samples: list[Load] = []

    def begin(self) -> None:
        """Start; samples of an earlier run are dropped."""
        self.end()
        self._ending, self._samples = threading.Event(), []
        arguments = (self._ending, self._samples)
        self._thread = threading.Thread(target=self._run, args=arguments, name="machine-load", daemon=True)
        self._thread.start()

    def end(self) -> list[Load]:
        """Stop; return the samples since `begin`."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(2 * PERIOD_S)
            self._thread = None
        return list(self._samples)

    def _run(self, ending: threading.Event, samples: list[Load]) -> None:
        psutil.cpu_percent()
        while not ending.wait(PERIOD_S):
            samples.append(sample(self._io_pressure))


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
