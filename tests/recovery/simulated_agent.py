"""Recovery on a fake clock: containers that the test starts and ends, units that it breaks, actions that it defines."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

from phm import testing
from phm.api import Layer, Result, Slot, Unit, error, ok
from phm.checking.pipeline import Pipeline
from phm.checking.plan import CheckPlan
from phm.core.bus import Bus
from phm.core.dependency_graph import DependencyGraph
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Note, Phase
from phm.core.settings import ContainerSettings, Settings
from phm.facts import ContainerFact
from phm.recovery.base import Action, ActionContext, NotNeeded, Target
from phm.recovery.executor import Executor
from phm.recovery.persistence.persistence_service import PersistenceService
from phm.recovery.safety.armed_state import ArmedMonitor, ArmedState, ArmedStatus
from phm.runtime.sections import action_settings
from phm.tracker import TrackedUnit, Tracker, graph_of
from phm.transport.docker import EngineError
from tests.fakes.until import until

STEP_S = 0.1
ARMED = ArmedStatus(ArmedState.ARMED, "the autopilot is armed")
DISARMED = ArmedStatus(ArmedState.DISARMED, "the autopilot is disarmed")


@dataclass(frozen=True, slots=True)
class Of:
    """A unit of a container, and its dependencies."""

    target: str
    needs: tuple[str, ...] = ()
    grace_s: float = 0.0
    settle_s: float = 0.0


class Containers:
    """The engine's answers; they survive PHM."""

    def __init__(self, *keys: str) -> None:
        self.facts = {key: testing.container(key) for key in keys}
        self._starts = self.asked = 0

    def get(self, key: str) -> ContainerFact | None:
        self.asked += 1
        return self.facts.get(key)

    def start(self, key: str, *, by_policy: bool = False) -> None:
        """A new life: by an operator or by PHM (the counter of the restart policy is 0 again), or by that policy."""
        self._starts += 1
        count = self.facts[key].restart_count + 1 if by_policy else 0
        changed = {"status": "running", "started_at": f"start {self._starts}", "restart_count": count}
        self.facts[key] = replace(self.facts[key], **changed)  # type: ignore[arg-type]

    def recreate(self, key: str) -> None:
        self.start(key)
        self.facts[key] = replace(self.facts[key], id=f"{key} of start {self._starts}")

    def end(self, key: str) -> None:
        self.facts[key] = replace(self.facts[key], status="exited")


class Silent:
    """An engine that does nothing; each call raises `fails`, if it is set."""

    act_limit_s = 15.0

    def __init__(self) -> None:
        self.fails: EngineError | None = None

    def restart(self, ref: str) -> None:
        self._answer()

    def inspect(self, ref: str) -> None:
        self._answer()

    def _answer(self) -> None:
        if self.fails is not None:
            raise self.fails


class Agent:
    """One life of PHM. `bad` maps units to the condition that their checks find; all others are OK.

    `behave` is the effect of an action on the container `key`; by default it starts it, like `restart`. It must wait
    only with `pause`.
    """

    def __init__(
        self,
        units: Mapping[str, Of],
        containers: Containers,
        clock: testing.FakeClock,
        *,
        folder: Path | None = None,
        opted_in: tuple[str, ...] = ("app",),
        critical: tuple[str, ...] = (),
        monitor: ArmedMonitor | None = None,
        actions: tuple[str, ...] = ("restart",),
        **recovery: Any,
    ) -> None:
        self.clock, self.containers = clock, containers
        self.events: list[Event] = []
        self.bad: dict[str, str] = {}
        self.found: dict[str, Result] = {}
        """Results of a unit's check that `bad` cannot express."""
        self.runs: list[tuple[str, str]] = []
        self.missing = ""
        """What actions wait for, as text."""
        self.not_missing: set[str] = set()
        """Units whose actions do not wait for it."""
        self.armed = False
        self._monitor = monitor
        self.acting: list[str] = []
        self._at_work: set[str] = set()
        self.other_cause: Callable[[], str] = lambda: ""
        self.behave: Callable[[str, ActionContext, Fault], object] = lambda key, context, fault: containers.start(key)
        entries = [
            ContainerSettings(name=key, recover=key in opted_in, flight_critical=key in critical)
            for key in containers.facts
        ]
        base: dict[str, Any] = {"containers": entries, "recovery": {"ladders": {"broken": ["restart"]}, **recovery}}
        self.settings = Settings.model_validate({**base, **({"state_dir": str(folder)} if folder else {})})
        tracked = tuple(
            TrackedUnit(
                Unit(name, of.needs, target=of.target, grace_s=of.grace_s, settle_s=of.settle_s),
                name,
                Slot.CONTAINER,
                Layer.DOCKER,
                1,
                of.needs,
            )
            for name, of in units.items()
        )
        self.units = tuple(units)
        self.bus = Bus(clock)
        self.pipeline = Pipeline(Tracker(tracked, graph_of(tracked), clock.stamp()), self.bus, clock)
        window_s = self.settings.recovery.window
        self.memory = (
            PersistenceService(str(folder), window_s, self.pipeline, self.bus, clock, monitor) if folder else None
        )
        if self.memory is not None:
            self.memory.restore()
        self.bus.subscribe("test", self.events.append)
        self.engine = Silent()
        context = ActionContext(
            cast(Any, self.engine),
            action_settings(self.settings),
            containers.get,
            lambda: None,
            lambda a, b: None,
        )
        plan = CheckPlan((), tracked, DependencyGraph({entry.unit.id: entry.needs for entry in tracked}))
        graces = {name: of.grace_s for name, of in units.items()}
        self.executor = Executor(
            self.pipeline,
            self._publish,
            clock,
            {name: self._action(name) for name in actions},
            context,
            self._armed,
            lambda unit: graces[unit],
            plan.below,
        )
        self.locks = self.executor.locks
        if self.memory is not None:
            self.memory.resume(self.executor)
        self.bus.subscribe("recovery", self.executor.handle, kinds=Executor.kinds, key=Executor.key)

    def _action(self, of: str) -> type[Action]:
        agent = self

        class Simulated(Action):
            name = of
            starts = of in ("start", "restart")
            leaves_running = of in ("reconnect", "join_network")
            deadline_s = 100.0
            on_phm_itself = of == "join_network"

            def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
                return agent.missing if fault.unit not in agent.not_missing else ""

            def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
                agent.runs.append((target.key, fault.unit))
                agent.acting.append(target.key)
                try:
                    said = agent.behave(target.key, context, fault)
                finally:
                    agent.acting.remove(target.key)
                return said if isinstance(said, NotNeeded) else "restarted"

            def other_cause(self, target: Target, fault: Fault, context: ActionContext) -> str:
                return agent.other_cause()

        return Simulated

    def _armed(self) -> ArmedStatus:
        if self._monitor is not None:
            return self._monitor.now()
        return ARMED if self.armed else DISARMED

    def _publish(self, event: Event) -> None:
        """Published by a worker's own thread: from STARTED until its result is known, the action has a thread, too."""
        if isinstance(event, ActionEvent):
            (self._at_work.add if event.phase is Phase.STARTED else self._at_work.discard)(event.target)
        self.bus.publish(event)

    # ------------------------------------------------------------ time

    def observe(self) -> None:
        for unit in self.units:
            condition = self.bad.get(unit)
            target = unit.partition("/")[2]
            found = (
                error(condition, brief=condition, condition=condition, target=target) if condition else ok("healthy")
            )
            found = self.found.get(unit, found)
            self.pipeline.observe({unit: found}, self.clock.mono(), 0.0)

    def step(self) -> None:
        self.clock.advance(STEP_S)
        self.observe()
        self.pipeline.tick()
        self._settle()

    def _settle(self) -> None:
        """Wait until all current work is done: the threads of the bus, of recovery and of actions sleep again."""
        until(self._is_idle, "all threads to be idle", poll_s=0.0002)

    def _is_idle(self) -> bool:
        with self.executor._lock:  # a worker that is being made is not in the list, but its thread may sleep already
            workers = len(self.executor._workers)
        return self.clock.sleepers >= len(self.bus._subscriptions) + workers + len(self._at_work)

    def pause(self, until: Callable[[], object]) -> None:
        """For actions: let some time pass, and more until `until` is true."""
        self.clock.wait(threading.Event(), STEP_S / 2)
        while not until():
            self.clock.wait(threading.Event(), STEP_S / 2)

    def until(self, condition: Callable[[], object], what: str = "it") -> None:
        """Let fake time pass until `condition` is true."""
        until(condition, what, lambda: self.events, step=self.step)

    def rest(self, seconds: float) -> None:
        """Let this much fake time pass."""
        for _ in range(round(seconds / STEP_S)):
            self.step()

    def stop(self) -> None:
        """End PHM, with its state on the disk."""
        if self.memory is not None:
            self.memory.close()
        self.executor.stop()
        self.bus.close()

    # ------------------------------------------------------------ observations

    def of(self, kind: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    def opened(self) -> list[str]:
        return [event.fault.unit for event in self.of(FaultOpened)]

    def closed(self) -> list[FaultClosed]:
        return self.of(FaultClosed)

    def actions(self) -> list[ActionEvent]:
        return self.of(ActionEvent)

    def steps(self, target: str = "app") -> list[Phase]:
        return [event.phase for event in self.of(ActionEvent) if event.target == target]

    def acted(self, phase: Phase = Phase.STARTED) -> list[str]:
        return [event.action for event in self.of(ActionEvent) if event.phase is phase]

    def notes(self) -> list[str]:
        return [event.text for event in self.of(Note)]
