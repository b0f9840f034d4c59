"""A bench for actions with any engine: current containers, and a graph that the test sets."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

from phm.core.clock import SystemClock
from phm.core.model import Evidence, Fault, Layer, Level, Result, Slot, Stamp
from phm.core.settings import Settings
from phm.facts import ContainerFact
from phm.probes.docker import Docker
from phm.recovery.attempt import GuardedEngine
from phm.recovery.base import Action, ActionContext, ActionSettings, Target
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.safety.flight_critical import FlightCriticalGuard
from phm.runtime.sections import action_settings
from phm.testing import settings
from phm.transport.docker import DockerEngine
from tests.proxy.haproxy import BehindProxy


def fault(unit: str, condition: str, evidence: Evidence | None = None, node: str = "") -> Fault:
    result = Result(Level.ERROR, "it is broken", "broken", condition, "app", evidence=evidence or Evidence())
    return Fault("F1", unit, Slot.CONTAINER, Layer.DOCKER, result, Stamp(0.0, 0.0), node=node)


def guarded(engine: DockerEngine, guard: FlightCriticalGuard) -> DockerEngine:
    """The guarded engine, typed as the engine that actions use."""
    return cast(DockerEngine, GuardedEngine(engine, guard, SystemClock()))


@dataclass
class Bench:
    """Runs actions. `nodes` are listed in the graph; `held` records which other containers were held for which fault."""

    engine: DockerEngine
    settings: Settings
    armed: bool = False
    nodes: dict[str, int] = field(default_factory=dict)
    held: list[tuple[str, str]] = field(default_factory=list)
    when_in_hand: Callable[[], object] = lambda: None
    probe: Docker | None = None
    """Caches answers for a moment, like PHM's own; without it each query goes to the engine."""

    def _armed(self) -> ArmedStatus:
        return ArmedStatus(ArmedState.ARMED if self.armed else ArmedState.DISARMED, f"armed: {self.armed}")

    def fact(self, key: str) -> ContainerFact | None:
        docker = self.probe or Docker(self.engine, self.settings.containers, self.settings.docker, SystemClock())
        return docker.container(key)

    @property
    def sections(self) -> ActionSettings:
        return action_settings(self.settings)

    def target(self, key: str) -> Target:
        found = self.settings.container(key)
        assert found is not None
        return Target.of(found)

    def context(self) -> ActionContext:
        flight_critical_guard = FlightCriticalGuard(
            self.settings.containers, self.fact, lambda: None, self._armed, self.engine.inspect
        )
        return ActionContext(
            guarded(self.engine, flight_critical_guard),
            self.sections,
            self.fact,
            lambda: None,
            lambda key, network: None,
            listed_nodes=lambda: self.nodes,
            lock_dependent=self._holding,
            armed=self._armed,
        )

    def run(self, action: type[Action], key: str, of: Fault) -> str:
        return action().run(self.target(key), of, self.context())

    @contextlib.contextmanager
    def _holding(self, key: str, of: Fault, action: str, at_most_s: float) -> Iterator[None]:
        self.held.append((key, of.unit))
        self.when_in_hand()
        yield


def bench(engine: DockerEngine, **yaml_like: object) -> Bench:
    """A bench with this engine, or with one behind a proxy with the rules of these settings."""
    if isinstance(engine, BehindProxy):
        return Bench(*engine.proxies.behind(**yaml_like))
    return Bench(engine, settings(**yaml_like))
