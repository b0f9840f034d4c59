"""The top CPU consumers by container name, from the host's cgroups or else from the engine. Requested only during
starvation."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from phm.core.clock import Clock
from phm.facts import CannotTell, ConsumerFact, NotPermitted
from phm.probes import cgroups
from phm.probes.docker_facts import TimeBudget
from phm.probes.kernel_file import head
from phm.transport.docker import DockerEngine

LEAST_S = 0.5
"""An earlier request returns the last answer."""
ENGINE_LEAST_S = 5.0
"""The same if the engine must be asked for each container, which costs it about 16 ms of CPU time each."""
MOST_S = 15.0
"""An older reading is not used for comparison."""
MOST_ASKED = 16
"""Number of containers whose statistics are requested at a time."""
BUDGET_S = 2.0
"""Deadline for all of these together: the engine of a starved machine is starved too."""
LEAST_CPUS = 0.05
"""Smaller consumers are not listed."""
_MOST_NAMES = 1000
_IDLE, _IOWAIT, _STEAL = 3, 4, 7


class TopConsumers:
    """Thread-safe. `known` returns the keys of configured containers by their full ids."""

    def __init__(
        self,
        engine: DockerEngine,
        root: Path,
        clock: Clock,
        known: Callable[[], Mapping[str, str]],
        proc: Path = Path("/proc"),
    ) -> None:
        self._engine, self._root, self._clock, self._known = engine, root, clock, known
        self._stat = str(proc / "stat")
        self._lock = threading.Lock()
        self._names: dict[str, str] = {}
        self._before: tuple[float, dict[str, float], float] | None = None
        self._last: tuple[ConsumerFact, ...] = ()
        self._cheap = self._may_list = True

    def read(self) -> tuple[ConsumerFact, ...]:
        """See `phm.facts.pressure.PressureProbe.consumers`. Raises CannotTell."""
        with self._lock:
            before = self._before
            least_s = LEAST_S if self._cheap else ENGINE_LEAST_S
            if before is not None and self._clock.mono() - before[0] < least_s:
                return self._last
            seen = cgroups.used_by_all(self._root)
            self._cheap = bool(seen)
            used = seen or self._by_engine()
            now, busy_s = self._clock.mono(), self._busy_s()
            self._before = now, used, busy_s
            fresh = before is not None and now - before[0] <= MOST_S
            self._last = self._since(before, now, used, busy_s) if fresh and before is not None else ()
            return self._last

    def _since(
        self, before: tuple[float, dict[str, float], float], now: float, used: dict[str, float], busy_s: float
    ) -> tuple[ConsumerFact, ...]:
        span_s = now - before[0]
        spent = {each: used[each] - before[1][each] for each in used.keys() & before[1].keys()}
        # A restarted container counts from 0: its use in between is unknown, and so is the rest for other programs.
        cpus = {each: seconds / span_s for each, seconds in spent.items() if seconds >= 0}
        whole = used.keys() == before[1].keys() and len(cpus) == len(used)
        outside = (busy_s - before[2]) / span_s - sum(cpus.values()) if whole else 0.0
        first = sorted((each for each in cpus if cpus[each] >= LEAST_CPUS), key=lambda each: -cpus[each])
        found = [ConsumerFact(self._name(each), cpus[each]) for each in first[:MOST_ASKED]]
        if outside >= LEAST_CPUS:
            found.append(ConsumerFact("", outside))
        return tuple(sorted(found, key=lambda fact: -fact.cpus))

    def _name(self, container: str) -> str:
        key = self._known().get(container) or self._names.get(container)
        if key is None:
            self._learn_names()
            key = self._names.setdefault(container, f"container {container[:12]}")
        return key

    def _learn_names(self) -> None:
        """Request the name once for each new container: one that the engine does not name keeps its id."""
        listed = self._list()
        if len(self._names) > _MOST_NAMES:
            self._names.clear()
        for entry in listed[:_MOST_NAMES]:
            names = entry.get("Names")
            if isinstance(names, list) and names:
                self._names[str(entry.get("Id"))] = str(names[0]).lstrip("/")

    def _list(self) -> Sequence[Mapping[str, Any]]:
        """All containers; none if the engine does not answer. A proxy that refuses is asked once."""
        if not self._may_list:
            return ()
        try:
            return self._engine.list(deadline_s=BUDGET_S)
        except NotPermitted:
            self._may_list = False
        except CannotTell:
            pass
        return ()

    def _by_engine(self) -> dict[str, float]:
        """CPU seconds by container: the configured ones first, as many as the engine answers for within the budget."""
        budget, used = TimeBudget(self._clock, BUDGET_S), {}
        running = [str(entry.get("Id")) for entry in self._list() if entry.get("State") == "running"]
        known = self._known()
        for container in [*known, *(each for each in running if each not in known)][:MOST_ASKED]:
            if budget.spent:
                break
            try:
                answer = self._engine.stats(container, deadline_s=budget.left_s())
            except CannotTell:
                continue
            cpu = answer.get("cpu_stats")
            usage = cpu.get("cpu_usage") if isinstance(cpu, dict) else None
            total_ns = usage.get("total_usage") if isinstance(usage, dict) else None
            if isinstance(total_ns, int):
                used[container] = total_ns / 1e9
        return used

    def _busy_s(self) -> float:
        """CPU seconds since boot that were not idle, of all CPUs together."""
        try:
            ticks = [int(word) for word in head(self._stat).split("\n", 1)[0].split()[1 : _STEAL + 2]]
        except (OSError, ValueError) as error:
            raise CannotTell(f"the kernel's figures cannot be read ({error}): is /proc mounted?") from error
        idle = sum(ticks[_IDLE : _IOWAIT + 1])
        return (sum(ticks) - idle) / os.sysconf("SC_CLK_TCK")
