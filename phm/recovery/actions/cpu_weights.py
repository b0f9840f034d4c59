"""CPU weights that PHM has lowered to relieve a starved container, and restores when that has been OK for a while."""

from __future__ import annotations

import bisect
import math
import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Protocol

from phm.core.clock import Clock
from phm.core.model import Event, FaultClosed, Level, UnitState
from phm.facts import CannotTell, ContainerFact
from phm.recovery.base import MAX_SHARES, LoweredWeight
from phm.transport.docker import DockerEngine, EngineMissing

LOW_SHARES = 64
"""Between a 33rd and an eighth of the default, by cgroup version and container runtime: enough to stay alive, almost nothing beside a
container that needs the core."""
DEFAULT_SHARES = 1024
CALM_S = 30.0
"""The weight is restored when the unit has been OK for this long. If it must be lowered again soon, the time doubles:
otherwise PHM would lower and restore it in turn."""
MOST_CALM_S = 600.0


def _linear(shares: int) -> int:
    """cpu.weight for these shares in older versions of runc and crun: 39 for 1024."""
    return 1 + (shares - 2) * 9999 // 262142


def _logarithmic(shares: int) -> int:
    """The same since opencontainers/runc pull request 4785: 100 for 1024."""
    log = math.log2(shares)
    return math.ceil(10 ** ((log * log + 125 * log) / 612 - 7 / 34))


CONVERSIONS: tuple[Callable[[int], int], ...] = (_linear, _logarithmic)
"""How container runtimes convert the engine's shares to the weight of cgroup v2."""


class PublishedStates(Protocol):
    """What is published; `phm.checking.pipeline.Pipeline` is one."""

    def states(self) -> tuple[UnitState, ...]: ...

    def note(self, kind: str, text: str) -> None: ...


class CpuWeights:
    """A subscriber of the bus, for its ticks. Thread-safe."""

    kinds = (FaultClosed,)
    period_s = 1.0

    def __init__(
        self,
        engine: DockerEngine,
        container: Callable[[str], ContainerFact],
        pipeline: PublishedStates,
        clock: Clock,
        weight: Callable[[ContainerFact], int] = lambda fact: 0,
    ) -> None:
        """container: the engine's data of any container, by id: a reload may have removed it from the configuration. Raises
        EngineMissing if there is none.
        weight: the kernel's weight of a container on cgroup v2; 0: not known.
        """
        self._engine, self._container, self._pipeline, self._clock = engine, container, pipeline, clock
        self._weight = weight
        # By container and unit: several starved containers may need the same weight low.
        self._lowered: dict[tuple[str, str], LoweredWeight] = {}
        self._calm_s: dict[str, float] = {}
        self._put_back_at: dict[str, float] = {}
        self._lock = threading.Lock()

    def restore(self, lowered: Iterable[LoweredWeight]) -> None:
        """What an earlier run of PHM had lowered."""
        with self._lock:
            self._lowered.update({(entry.key, entry.unit): entry for entry in lowered})

    def kept(self) -> tuple[LoweredWeight, ...]:
        with self._lock:
            return tuple(self._lowered.values())

    def lower(self, key: str, fact: ContainerFact, unit: str, engine: DockerEngine) -> bool:
        """Lower the CPU weight of a running container through `engine`, until `unit` is OK. Returns False if it is already that low.
        Raises CannotTell."""
        host = engine.inspect(fact.id).get("HostConfig")
        found = host.get("CpuShares") if isinstance(host, dict) else None
        shares = found if isinstance(found, int) and found > 0 else DEFAULT_SHARES
        if shares <= LOW_SHARES:
            self._keep_low(key, fact.id, unit)
            return False
        # Without shares the kernel's default applies. On cgroup v2 that may be another weight than that of the engine's default.
        weight = 0 if found else self._weight(fact)
        with self._lock:  # noted first: if PHM is stopped in between, the next PHM restores it
            self._note(LoweredWeight(key, fact.id, shares, unit, weight))
            again = self._clock.mono() - self._put_back_at.get(key, float("-inf")) < MOST_CALM_S
            self._calm_s[key] = min(2 * self._calm_s.get(key, CALM_S), MOST_CALM_S) if again else CALM_S
        engine.set_cpu_shares(fact.id, LOW_SHARES)
        return True

    def _keep_low(self, key: str, container: str, unit: str) -> None:
        """What was lowered for another unit stays low for this one, too. A weight that PHM has not lowered is the container's own."""
        with self._lock:
            entry = next((each for each in self._lowered.values() if (each.key, each.id) == (key, container)), None)
            if entry is not None:
                self._note(replace(entry, unit=unit))

    def _note(self, entry: LoweredWeight) -> None:
        """Add the unit to those that need the weight low. What was noted for an earlier container of this name is over."""
        before = {unit: self._lowered.pop((key, unit)) for key, unit in tuple(self._lowered) if key == entry.key}
        units = {unit for unit, other in before.items() if other.id == entry.id} | {entry.unit}
        self._lowered.update({(entry.key, unit): replace(entry, unit=unit) for unit in sorted(units)})

    def handle(self, event: Event) -> None:
        """Ignored: only time decides when a weight is restored."""

    def tick(self) -> None:
        """Restore weights that need not be low any more."""
        states = {state.unit: state for state in self._pipeline.states()}
        now = self._clock.mono()
        for entry in self.kept():
            state = states.get(entry.unit)
            calm_s = self._calm_s.get(entry.key, CALM_S)
            if state is None or (state.level is Level.OK and now - state.since.mono >= calm_s):
                self._not_needed(entry)

    def end(self) -> None:
        """Restore all weights: PHM stops, and nothing else would do it later."""
        for entry in {entry.key: entry for entry in self.kept()}.values():
            self._put_back(entry)

    def _not_needed(self, entry: LoweredWeight) -> None:
        """The unit of the entry does not need it any more; the weight is restored when none does."""
        with self._lock:
            shared = sum(key == entry.key for key, _ in self._lowered) > 1
            if shared:
                del self._lowered[entry.key, entry.unit]
        if not shared:
            self._put_back(entry)

    def _put_back(self, entry: LoweredWeight) -> None:
        """A container that was recreated since has the weight that it was created with. What is noted meanwhile stays: another thread
        has lowered the weight again."""
        before = [other for other in self.kept() if other.key == entry.key]
        try:
            shares = self._set_back(entry, self._container(entry.id))
        except EngineMissing:
            shares = 0
        except CannotTell:
            return  # at the next tick
        with self._lock:
            self._lowered = {
                noted: other for noted, other in self._lowered.items() if not any(other is each for each in before)
            }
            self._put_back_at[entry.key] = self._clock.mono()
        if shares:
            self._pipeline.note("ACTION", f"restored the CPU weight of {entry.key} to {shares}")

    def _set_back(self, entry: LoweredWeight, fact: ContainerFact) -> int:
        """Returns the shares that the container has then. Raises CannotTell."""
        self._engine.set_cpu_shares(entry.id, entry.shares)
        shares = _shares_for(entry, self._weight(fact)) if entry.weight else entry.shares
        if shares != entry.shares:
            self._engine.set_cpu_shares(entry.id, shares)
        return shares


def _shares_for(entry: LoweredWeight, weight: int) -> int:
    """The shares that give the weight from before, if those of the entry give `weight`; those of the entry if the conversion is not
    known."""
    convert = next((each for each in CONVERSIONS if each(entry.shares) == weight), None)
    if convert is None or weight == entry.weight:
        return entry.shares
    return min(MAX_SHARES, 2 + bisect.bisect_left(range(2, MAX_SHARES + 1), entry.weight, key=convert))
