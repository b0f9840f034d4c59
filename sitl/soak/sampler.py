"""Takes a sample of every agent again and again, in a thread, and writes it to the file immediately."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from docker import DockerClient
from docker.errors import DockerException

from sitl.campaign.cost_meter import PROCESSES
from sitl.faults._cgroups import cgroup, cpu_of
from sitl.faults.base import Agent
from sitl.soak.process_tree import Wakeups, descriptors, memory_mb, tree
from sitl.soak.sample import Sample, to_json


@dataclass
class _Watched:
    """One agent's sidecar: its first process, its cgroup, and totals over its restarts."""

    first: int = 0
    folder: Path | None = None
    cpu_s: float = 0.0
    last_cpu_s: float | None = None
    wakeups: Wakeups = field(default_factory=Wakeups)


class Sampler:
    """Every `period_s` between `start` and `stop`. An agent whose sidecar does not run is left out of a round."""

    def __init__(self, agents: Mapping[int, Agent], file: Path, period_s: float) -> None:
        self._agents, self._file, self._period_s = agents, file, period_s
        self._watched = {number: _Watched() for number in agents}
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="soak-samples", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """The round at work is completed."""
        self._ending.set()
        self._thread.join(60.0)

    def _run(self) -> None:
        client = DockerClient.from_env()  # a thread's own: they are not safe to share
        try:
            with self._file.open("a", encoding="ascii") as stream:
                due = time.monotonic()
                while not self._ending.wait(max(0.0, due - time.monotonic())):
                    due = max(due + self._period_s, time.monotonic())
                    for number in self._agents:
                        sample = self._sample(number, client)
                        if sample is not None:
                            stream.write(to_json(sample) + "\n")
                    stream.flush()
        finally:
            client.close()

    def _sample(self, number: int, client: DockerClient) -> Sample | None:
        watched, agent = self._watched[number], self._agents[number]
        try:
            if watched.folder is None:
                sidecar = Agent(agent.project, agent.name, client).sidecar
                watched.folder, watched.first = cgroup(sidecar, "cpuacct"), int(sidecar.attrs["State"]["Pid"])
            used_s = cpu_of(watched.folder)
            pids = [int(line) for line in (watched.folder / PROCESSES).read_text("ascii").splitlines()]
            found = tree(watched.first, pids)
        except (DockerException, LookupError, OSError):
            watched.folder = watched.last_cpu_s = None  # it does not run, or has ended just now
            return None
        if watched.last_cpu_s is not None:
            watched.cpu_s += max(0.0, used_s - watched.last_cpu_s)
        watched.last_cpu_s = used_s
        threads = watched.wakeups.take(found.pids)
        resident, private = memory_mb(found.pids)
        return Sample(
            mono=round(time.monotonic(), 3),
            utc=round(time.time(), 3),
            agent=number,
            run=found.daemon,
            resident_mb=round(resident, 3),
            private_mb=round(private, 3),
            descriptors=descriptors(found.pids),
            threads=threads,
            cpu_s=round(watched.cpu_s, 4),
            wakeups=watched.wakeups.total,
            log_bytes=_size(agent.logs),
        )


def _size(folder: Path | None) -> int:
    """Bytes of all files below a folder; one that is rotated away meanwhile has none."""
    total = 0
    for path in folder.rglob("*") if folder is not None else ():
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total
