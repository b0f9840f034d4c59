"""The real recovery around the simulated agent: executor, worker, policy and verification, with simulated effects.

Threads of recovery alternate with the simulation: at each tick the clock moves, and the simulation waits until they all
sleep again. So an example is reproducible.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar, cast

from phm.checking.pipeline import Pipeline
from phm.core.bus import Bus
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Phase, Transition
from phm.recovery.actions.join_network import JoinNetwork
from phm.recovery.actions.reconnect import Reconnect
from phm.recovery.actions.relaunch import Relaunch
from phm.recovery.actions.restart import Restart
from phm.recovery.actions.restore_file import RestoreFile
from phm.recovery.actions.start import Start
from phm.recovery.actions.unpause import Unpause
from phm.recovery.base import Action, ActionContext, Target
from phm.recovery.executor import Executor
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.runtime.sections import action_settings
from phm.testing import FakeClock
from tests.fakes.agent_world import FIXES, Sim

REAL_LIMIT_S = 60.0
KINDS = {kind.name: kind for kind in (Start, Restart, Unpause, Reconnect, JoinNetwork, Relaunch, RestoreFile)}


@dataclass(frozen=True, slots=True)
class Acted:
    """An action that ran from `began` to `ended`, before its verification; whether it was meant to help."""

    action: str
    unit: str
    began: float
    ended: float
    helps: bool


class SimClock(FakeClock):
    """Shows the time of the simulation."""

    def __init__(self, sim: Sim) -> None:
        super().__init__(sim.now, sim.stamp().utc)

    def follow(self, sim: Sim) -> None:
        self.advance(max(0.0, sim.now - self.mono()))


class SimPipeline(Pipeline):
    """The real one on the simulation's tracker. Records held units, and units with grace since the end of a hold."""

    def __init__(self, sim: Sim, bus: Bus, clock: SimClock) -> None:
        super().__init__(sim.tracker, bus, clock)
        self._sim = sim

    def begin_action(self, target: str, owner: str, action: str, at_most_s: float, **marks: bool) -> None:
        self._sim.held, self._sim.held_until = owner, self._sim.now + at_most_s
        super().begin_action(target, owner, action, at_most_s, **marks)

    def end_action(self, target: str, *, worked: bool) -> None:
        self._sim.held = ""
        self._sim.grant(self._sim.touched)
        super().end_action(target, worked=worked)

    def clear_given_up(self, *units: str) -> None:
        given_up = {fault.unit for fault in self.given_up()}.intersection(units)
        self._sim.reset_units += sorted(given_up)
        self._sim.grant(given_up)
        super().clear_given_up(*units)


class SimBus:
    """Delivers events to recovery at the next tick."""

    def __init__(self, sim: Sim) -> None:
        self._sim = sim

    def publish(self, event: Event) -> None:
        self._sim.publish(event)


class SimRecovery:
    """Recovery for the one container. `helps` is the probability that an action has its effect; `in_part` that an effective
    action which is not the last of its ladder restores only a part.

    `acted` has the actions in order. Asserts for each new action: no other is running, the budget is kept, and nothing
    flight-critical is touched while armed.
    """

    def __init__(
        self,
        sim: Sim,
        *,
        helps: float = 1.0,
        in_part: float = 0.0,
        armed: Callable[[float], bool] = lambda now: False,
        critical: bool = False,
        **recovery: Any,
    ) -> None:
        self.sim, self.helps, self.in_part, self.armed, self.critical = sim, helps, in_part, armed, critical
        self.rules = sim.settings.recovery.model_copy(update=recovery)
        entry = sim.settings.containers[0].model_copy(update={"flight_critical": critical})
        settings = sim.settings.model_copy(update={"recovery": self.rules, "containers": [entry]})
        self.acted: list[Acted] = []
        self.begun: list[float] = []
        self.left_lost: Counter[str] = Counter()
        self._acting: list[str] = []
        self._at_work = False
        self._broken: list[str] = []
        self._queue: deque[Event] = deque()
        self._clock = SimClock(sim)
        pipeline = SimPipeline(sim, cast(Any, SimBus(sim)), self._clock)
        pipeline.attach(self._wake)
        context = ActionContext(
            cast(Any, SimpleNamespace(inspect=None)),
            action_settings(settings),
            lambda key: sim.world.fact(sim.now),
            lambda: None,
            lambda a, b: None,
        )
        graces = {entry.unit.id: entry.unit.grace_s for entry in sim.plan.tracked}
        kinds = {name: self._action(kind) for name, kind in KINDS.items()}
        self._executor = Executor(
            pipeline, self._publish, self._clock, kinds, context, self._armed, graces.__getitem__, sim.plan.below
        )
        sim.listeners.append(self._queue.append)
        sim.watch.append(self._turn)

    def stop(self) -> None:
        """End the threads of recovery."""
        self._executor.stop()
        self._clock.advance(1e6)

    # ------------------------------------------------------------ alternating threads

    def _turn(self) -> None:
        self._clock.follow(self.sim)
        self._settle()
        while self._queue:
            event = self._queue.popleft()
            if isinstance(event, (FaultOpened, FaultClosed, Transition)):
                self._executor.handle(event)
        self._settle()
        assert not self._broken, self._broken

    def _settle(self) -> None:
        self._clock.wait_for_sleepers(lambda: len(self._executor._workers) + self._at_work, REAL_LIMIT_S)

    def _publish(self, event: Event) -> None:
        """Called by the worker's own thread: from STARTED until it knows the result, the action's thread must sleep, too."""
        if isinstance(event, ActionEvent):
            self._at_work = event.phase is Phase.STARTED
        self.sim.publish(event)

    def _wake(self, units: Iterable[str], reason: str) -> None:
        self.sim.wake(units, 0.9 if reason == "confirm" else 0.1)

    def _armed(self) -> ArmedStatus:
        armed = self.armed(self.sim.now)
        return ArmedStatus(
            ArmedState.ARMED if armed else ArmedState.DISARMED, "the autopilot is " + ("armed" if armed else "disarmed")
        )

    # ------------------------------------------------------------ effects of actions

    def _action(self, kind: type[Action]) -> type[Action]:
        recovery = self

        class Simulated(Action):
            name: ClassVar[str] = kind.name
            leaves_running: ClassVar[bool] = kind.leaves_running
            deadline_s: ClassVar[float] = kind.deadline_s
            verify_after_s: ClassVar[float] = kind.verify_after_s

            def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
                recovery._act(self.name, fault)
                return "done"

        return Simulated

    def _act(self, action: str, fault: Fault) -> None:
        sim, began = self.sim, self.sim.now
        self._begins(fault)
        self._acting.append(action)
        try:
            self._pause(sim.random.uniform(0.1, 1.0))
            helps = sim.random.random() < self.helps
            self._change(action, helps)
        finally:
            self._acting.remove(action)
        self.acted.append(Acted(action, fault.unit, began, sim.now, helps))

    def _begins(self, fault: Fault) -> None:
        """Raise violations in the simulation's own thread: recovery survives exceptions of actions."""
        now = self.sim.now
        self.begun.append(now)
        recent = [began for began in self.begun if began > now - self.rules.window]
        broken = {
            "another action is at work": bool(self._acting),
            "the container is not held for this fault": self.sim.held != fault.unit,
            "the vehicle is armed": self.critical and self.armed(now),
            "the budget is exceeded": len(recent) > self.rules.budget,
        }
        self._broken += [f"{fault.unit} at {now:.1f}: {rule}" for rule, is_broken in broken.items() if is_broken]

    def _change(self, action: str, helps: bool) -> None:
        world = self.sim.world
        up = self.sim.now
        ends_again = "container" in world.active and not helps
        if action == "restart" and not ends_again:
            up = world.restart(self.sim.now)
        elif action in ("start", "restart") and not world.fact(up).running:
            world.record_start(up)
        in_part = action not in ("restart", "join_network") and self.sim.random.random() < self.in_part
        for kind in sorted(FIXES[action].intersection(world.active)) if helps else ():
            if in_part:
                self.left_lost.update({span.unit for span in world.active[kind][1:]})
            (world.repair_in_part if in_part else world.repair)(kind, up)
        self._pause(up - self.sim.now)

    def _pause(self, seconds: float) -> None:
        if seconds > 0:
            self._clock.wait(threading.Event(), seconds)
