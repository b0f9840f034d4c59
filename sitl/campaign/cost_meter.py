"""Measures CPU and memory of each agent's sidecar during a trial: all that ever ran in its container."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from docker import DockerClient
from docker.errors import DockerException

from sitl.campaign.trial import Cost
from sitl.faults._cgroups import cgroup, cpu_of
from sitl.faults.base import Agent

PERIOD_S = 1.0
PSS_EVERY = 10
"""Samples: the kernel walks all pages of a process for its proportional share."""
PROC = Path("/proc")
PAGE = os.sysconf("SC_PAGE_SIZE")
PROCESSES = "cgroup.procs"
Find = Callable[[int], Path]


@dataclass
class _Meter:
    """Of one sidecar. A restarted container has a new cgroup, whose counter begins at 0."""

    folder: Path | None = None
    last_s: float = 0.0
    used_s: float = 0.0
    rss: list[float] = field(default_factory=list)
    pss: list[float] = field(default_factory=list)

    def take(self, cpu_s: float) -> None:
        self.used_s += cpu_s - self.last_s if cpu_s >= self.last_s else cpu_s
        self.last_s = cpu_s


class CostMeter:
    """Samples once a second between `begin` and `costs`, in a thread. `find`: the folder of an agent's sidecar's CPU cgroup,
    LookupError while it does not run.
    """

    def __init__(self, agents: Mapping[int, Agent], find: Find | None = None) -> None:
        self._agents, self._find = agents, find
        self._meters: dict[int, _Meter] = {}
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._since = 0.0

    def begin(self) -> None:
        """Start; samples of an earlier trial are dropped."""
        self._stop()
        self._ending, self._since = threading.Event(), time.monotonic()
        self._meters = {number: _Meter() for number in self._agents}
        self._thread = threading.Thread(target=self._run, args=(self._ending, self._meters), name="cost", daemon=True)
        self._thread.start()

    def costs(self) -> list[Cost]:
        """Stop; the cost since `begin`. An agent whose sidecar was never seen running is left out."""
        self._stop()
        seconds = time.monotonic() - self._since
        return [
            Cost(
                number,
                seconds,
                round(meter.used_s, 4),
                round(_mean(meter.rss), 2),
                round(_mean(meter.pss), 2) if meter.pss else None,
                round(max(meter.rss), 2),
            )
            for number, meter in self._meters.items()
            if meter.rss
        ]

    def _stop(self) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join(10 * PERIOD_S)
            self._thread = None

    def _run(self, ending: threading.Event, meters: Mapping[int, _Meter]) -> None:
        client = None if self._find else DockerClient.from_env()  # a thread's own: they are not safe to share
        find = self._find or partial(self._sidecar, client)
        count = 0
        while True:
            for number, meter in meters.items():
                _sample(meter, partial(find, number), pss=count % PSS_EVERY == 0)
            count += 1
            if ending.wait(PERIOD_S):
                break
        for number, meter in meters.items():  # to the very end
            _sample(meter, partial(find, number), pss=False)
        if client is not None:
            client.close()

    def _sidecar(self, client: DockerClient | None, number: int) -> Path:
        agent = self._agents[number]
        mine = Agent(agent.project, agent.name, client or agent.docker)
        return cgroup(mine.sidecar, "cpuacct")


def _sample(meter: _Meter, find: Callable[[], Path], *, pss: bool) -> None:
    fresh = meter.folder is None
    try:
        if meter.folder is None:
            meter.folder = find()
        cpu_s = cpu_of(meter.folder)
    except (DockerException, LookupError, OSError):
        meter.folder = None  # it does not run, or ended just now
        return
    if fresh and not meter.rss:
        meter.last_s = cpu_s  # what it used before the trial
    meter.take(cpu_s)
    pids = _pids(meter.folder)
    if pids:
        meter.rss.append(sum(_memory(pid, "Rss:") if pss else _rss(pid) for pid in pids))
        if pss:
            meter.pss.append(sum(_memory(pid, "Pss:") for pid in pids))


def _pids(folder: Path) -> list[int]:
    try:
        return [int(line) for line in (folder / PROCESSES).read_text("ascii").splitlines()]
    except OSError:
        return []


def _rss(pid: int) -> float:
    """Resident memory of a process in MB; 0 when it is gone."""
    with contextlib.suppress(OSError, IndexError, ValueError):
        return int((PROC / str(pid) / "statm").read_text("ascii").split()[1]) * PAGE / 1e6
    return 0.0


def _memory(pid: int, key: str) -> float:
    """A line of a process's memory summary in MB; 0 when it is gone."""
    with contextlib.suppress(OSError):
        for line in (PROC / str(pid) / "smaps_rollup").read_text("ascii").splitlines():
            if line.startswith(key):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0


def _mean(values: list[float]) -> float:
    return sum(values) / len(values)
