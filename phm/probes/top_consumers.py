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
MOST_S, ENGINE_MOST_S = 15.0, 60.0
"""An older reading is not used for comparison: of files, and of the engine, which is not asked for every container each time."""
MOST_ASKED = 16
"""Number of containers whose statistics are requested at a time."""
BUDGET_S, LIST_S = 2.0, 1.0
"""Deadline for all of these together, and of that for their list: the engine of a starved machine is starved too."""
AGAIN_S = 5.0
"""An engine that did not answer with a list is not asked for another one for this long."""
LEAST_CPUS = 0.05
"""Smaller consumers are not listed."""
_MOST_NAMES = 1000
_IDLE, _IOWAIT, _STEAL = 3, 4, 7
_Reading = tuple[float, float]
"""(Monotonic second, CPU seconds used until then.)"""


class TopConsumers:
    """Thread-safe. `known` returns the keys of configured containers by their full ids, `groups` the cgroups of those that
    were found."""

    def __init__(
        self,
        engine: DockerEngine,
        root: Path,
        clock: Clock,
        known: Callable[[], Mapping[str, str]],
        proc: Path = Path("/proc"),
        groups: Callable[[], Sequence[cgroups.Cgroup]] = tuple,
    ) -> None:
        self._groups = groups
        self._engine, self._root, self._clock, self._known = engine, root, clock, known
        self._stat = str(proc / "stat")
        self._lock = threading.Lock()
        self._names: dict[str, str] = {}
        self._running: tuple[str, ...] = ()
        self._asked: dict[str, float] = {}
        self._seen: dict[str, _Reading] = {}
        self._cpus: dict[str, _Reading] = {}
        self._whole: tuple[float, dict[str, _Reading], float] | None = None
        self._last: tuple[ConsumerFact, ...] = ()
        self._read_at = float("-inf")
        self._cheap = self._may_list = True
        self._list_at = float("-inf")
        """When the engine may be asked for a list again."""

    def read(self) -> tuple[ConsumerFact, ...]:
        """See `phm.facts.pressure.PressureProbe.consumers`. Raises CannotTell."""
        with self._lock:
            now = self._clock.mono()
            if now - self._read_at < (LEAST_S if self._cheap else ENGINE_LEAST_S):
                return self._last
            budget = TimeBudget(self._clock, BUDGET_S)
            by_files = cgroups.used_by_all(self._root, self._groups())
            used, every = {each: (now, spent) for each, spent in by_files.items()}, True
            self._cheap = bool(used)
            if not used:
                used, every = self._by_engine(budget)
            self._read_at, busy_s = self._clock.mono(), self._busy_s()
            self._compare(used, MOST_S if self._cheap else ENGINE_MOST_S)
            outside = self._outside(used, busy_s) if every else 0.0
            self._whole = (self._read_at, used, busy_s) if every else None
            self._last = self._facts(outside, budget)
            return self._last

    def _compare(self, used: Mapping[str, _Reading], most_s: float) -> None:
        """Compare each container with its own last reading; those that do not run any more are forgotten."""
        present = set(used) if self._cheap else {*used, *self._running}
        for table in (self._seen, self._cpus, self._asked):
            for each in [each for each in table if each not in present]:
                del table[each]
        for each, (at, spent_s) in used.items():
            before = self._seen.get(each)
            self._seen[each] = at, spent_s
            # A restarted container counts from 0: its use in between is unknown.
            if before is not None and spent_s >= before[1] and before[0] < at <= before[0] + most_s:
                self._cpus[each] = at, (spent_s - before[1]) / (at - before[0])
            else:
                self._cpus.pop(each, None)
        for each in [each for each, (at, _) in self._seen.items() if self._read_at - at > most_s]:
            del self._seen[each]
            self._cpus.pop(each, None)

    def _outside(self, used: Mapping[str, _Reading], busy_s: float) -> float:
        """CPUs used by what is not in a container. Known only between two readings of all the same containers."""
        if self._whole is None or used.keys() != self._whole[1].keys() or used.keys() != self._cpus.keys():
            return 0.0
        span_s = self._read_at - self._whole[0]
        if not 0.0 < span_s <= MOST_S:
            return 0.0
        return (busy_s - self._whole[2]) / span_s - sum(cpus for _, cpus in self._cpus.values())

    def _facts(self, outside: float, budget: TimeBudget) -> tuple[ConsumerFact, ...]:
        first = sorted(((cpus, each) for each, (_, cpus) in self._cpus.items() if cpus >= LEAST_CPUS), reverse=True)[
            :MOST_ASKED
        ]
        known = self._known()
        self._learn_names([each for _, each in first if each not in known and each not in self._names], budget)
        found = [ConsumerFact(known.get(each) or self._names.get(each) or _by_id(each), cpus) for cpus, each in first]
        if outside >= LEAST_CPUS:
            found.append(ConsumerFact("", outside))
        return tuple(sorted(found, key=lambda fact: -fact.cpus))

    def _learn_names(self, new: Sequence[str], budget: TimeBudget) -> None:
        """Request the names of new containers with one call; one that the engine's answer does not name keeps its id."""
        listed = self._list(budget.left_s()) if new and not budget.used_up else None
        if listed is not None:
            self._take_names(listed)
            for container in new:
                self._names.setdefault(container, _by_id(container))

    def _take_names(self, listed: Sequence[Mapping[str, Any]]) -> None:
        if len(self._names) > _MOST_NAMES:
            self._names.clear()
        for entry in listed[:_MOST_NAMES]:
            names = entry.get("Names")
            if isinstance(names, list) and names:
                self._names[str(entry.get("Id"))] = str(names[0]).lstrip("/")

    def _list(self, deadline_s: float) -> Sequence[Mapping[str, Any]] | None:
        """All containers; None if the engine does not answer, which is then not asked for a while. A proxy that refuses is asked once."""
        if not self._may_list or self._clock.mono() < self._list_at:
            return None
        try:
            return self._engine.list(deadline_s=deadline_s)
        except NotPermitted:
            self._may_list = False
        except CannotTell:
            self._list_at = self._clock.mono() + AGAIN_S
        return None

    def _by_engine(self, budget: TimeBudget) -> tuple[dict[str, _Reading], bool]:
        """Readings by container, of as many as the engine answers for within the budget, and whether these are all that run.

        On a busy machine, or with many containers, one reading does not reach all of them. Those come first that were asked about
        once, since their use is known only after the second time; then those not asked about for the longest time.
        """
        used: dict[str, _Reading] = {}
        listed = self._list(LIST_S)
        if listed is not None:
            self._take_names(listed)
            self._running = tuple(str(entry.get("Id")) for entry in listed if entry.get("State") == "running")
        present = tuple(dict.fromkeys((*self._known(), *self._running)))[:_MOST_NAMES]
        begun = self._seen.keys() - self._cpus.keys()
        turn = sorted(present, key=lambda each: (each not in begun, self._asked.get(each, float("-inf"))))
        for container in turn[:MOST_ASKED]:
            if budget.used_up:
                break
            self._asked[container] = self._clock.mono()
            spent_s = self._ask(container, budget.left_s())
            if spent_s is not None:
                used[container] = self._clock.mono(), spent_s
        return used, listed is not None and len(used) == len(present)

    def _ask(self, container: str, deadline_s: float) -> float | None:
        """Its CPU seconds; None if the engine does not know."""
        try:
            answer = self._engine.stats(container, deadline_s=deadline_s)
        except CannotTell:
            return None
        cpu = answer.get("cpu_stats")
        usage = cpu.get("cpu_usage") if isinstance(cpu, dict) else None
        total_ns = usage.get("total_usage") if isinstance(usage, dict) else None
        return total_ns / 1e9 if isinstance(total_ns, int) else None

    def _busy_s(self) -> float:
        """CPU seconds since boot that were not idle, of all CPUs together."""
        try:
            ticks = [int(word) for word in head(self._stat).split("\n", 1)[0].split()[1 : _STEAL + 2]]
        except (OSError, ValueError) as error:
            raise CannotTell(f"the kernel's figures cannot be read ({error}): is /proc mounted?") from error
        idle = sum(ticks[_IDLE : _IOWAIT + 1])
        return (sum(ticks) - idle) / os.sysconf("SC_CLK_TCK")


def _by_id(container: str) -> str:
    return f"container {container[:12]}"
