"""The pressure probe: how long each configured container waits for resources, from its cgroup or else from the engine."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from phm.core.clock import Clock
from phm.core.settings import ContainerSettings, PressureSettings
from phm.facts import CannotTell, CgroupState, ConsumerFact, DockerProbe, PressureFact
from phm.probes import cgroups, engine_stats
from phm.probes.stall_sampler import SUSPECT, StallSampler
from phm.probes.top_consumers import TopConsumers
from phm.transport.docker import DockerEngine, EngineMissing

ENGINE_EVERY_S = 2.0
"""Time between two requests for the engine's statistics of a container, which cost about 40 times as much as reading
files."""
CACHE_EVERY_S = 10.0
"""Time between two readings of a container's memory.stat, which takes longer than all other files together."""


@dataclass(slots=True)
class _Entry:
    """State of one container. Invariant: read and written with `lock` held."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    id: str = ""
    group: cgroups.Cgroup | None = None
    answer: PressureFact | None = None
    asked_at: float = float("-inf")
    before: PressureFact | None = None
    """The previous reading of its files."""
    newest: tuple[str, cgroups.Cgroup] | None = None
    """Id and cgroup of the container that was found last; kept when that has gone. Replaced as a whole, and read without `lock`."""
    without_cache: int | None = None
    cache_at: float = float("-inf")


class Pressure:
    """A `phm.facts.PressureProbe`. Thread-safe. The host's cgroups are read at `pressure.cgroups`."""

    def __init__(
        self,
        engine: DockerEngine,
        docker: DockerProbe,
        containers: Sequence[ContainerSettings],
        settings: PressureSettings,
        clock: Clock,
    ) -> None:
        self._engine, self._docker, self._clock = engine, docker, clock
        self._root = Path(settings.cgroups)
        self._entries = {entry.key: _Entry() for entry in containers}
        self._sampler = StallSampler(clock)
        self._consumers = TopConsumers(engine, self._root, clock, self._known, groups=self._groups)

    def container(self, name: str) -> PressureFact | None:
        entry = self._entries.get(name)
        if entry is None:
            raise CannotTell(f"no container {name} is configured")
        if not entry.lock.acquire(timeout=self._engine.timeout_s + 1):
            raise CannotTell(f"the Docker Engine is still answering an earlier request for {name}")
        try:
            return self._by_files(entry) or self._find_again(name, entry)
        finally:
            entry.lock.release()

    def state(self, name: str, container_id: str) -> CgroupState | None:
        entry = self._entries.get(name)
        newest = entry.newest if entry is not None else None
        return cgroups.state(self._root, newest[1]) if newest is not None and newest[0] == container_id else None

    def consumers(self) -> tuple[ConsumerFact, ...]:
        return self._consumers.read()

    def _known(self) -> dict[str, str]:
        return {entry.id: key for key, entry in self._entries.items() if entry.id}

    def _groups(self) -> list[cgroups.Cgroup]:
        found = [entry.newest for entry in self._entries.values()]
        return [newest[1] for newest in found if newest is not None]

    def _by_files(self, entry: _Entry) -> PressureFact | None:
        """While its cgroup exists the engine is not asked: it may be starved too."""
        if entry.group is None:
            return None
        try:
            fact = cgroups.read(entry.group, self._clock.mono())
            if _waits(entry.before, fact):
                self._sampler.suspect(f"{entry.group.unified}/cpu.pressure")
            entry.before = fact
            return self._with_cache(entry, entry.group, fact)
        except OSError:
            entry.group = None
            return None
        except ValueError as error:
            raise CannotTell(f"the files of its cgroup cannot be parsed ({error})") from error

    @staticmethod
    def _with_cache(entry: _Entry, group: cgroups.Cgroup, fact: PressureFact) -> PressureFact:
        if fact.at - entry.cache_at >= CACHE_EVERY_S:
            entry.cache_at = fact.at
            entry.without_cache = cgroups.without_cache(group, fact.memory_bytes)
        return replace(fact, without_cache_bytes=entry.without_cache)

    def _find_again(self, name: str, entry: _Entry) -> PressureFact | None:
        if self._clock.mono() - entry.asked_at < ENGINE_EVERY_S:
            return entry.answer
        container = self._docker.container(name)
        entry.id = container.id if container is not None and container.running else ""
        if container is None or not container.running:
            return None
        entry.group, entry.cache_at = cgroups.find(self._root, container), float("-inf")
        entry.newest = (container.id, entry.group) if entry.group is not None else None
        found = self._by_files(entry)
        if found is not None:
            return found
        try:
            answer = self._engine.stats(container.id)
        except EngineMissing:
            return None
        entry.asked_at = self._clock.mono()
        entry.answer = engine_stats.pressure_fact(answer, container, entry.asked_at)
        return entry.answer


def _waits(before: PressureFact | None, now: PressureFact) -> bool:
    """Whether the container seems to wait for a CPU."""
    if before is None or before.cpu is None or now.cpu is None or before.generation != now.generation:
        return False
    if before.cpu.full_s is None or now.cpu.full_s is None:
        return False
    return now.cpu.full_s - before.cpu.full_s >= SUSPECT * (now.at - before.at) > 0
