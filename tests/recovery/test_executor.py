"""The executor: acts once per container, verifies the result, and cannot be blocked by a hang."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm import testing
from phm.api import Layer, Slot, Unit, error, ok
from phm.checking.pipeline import Pipeline
from phm.core.bus import Bus
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Level, Phase
from phm.core.settings import ContainerSettings, Settings
from phm.facts import NotPermitted
from phm.recovery.attempt import HUNG_S
from phm.recovery.base import Action, ActionContext, ActionFailed, Target
from phm.recovery.executor import Executor, NotNow
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.runtime.sections import action_settings
from phm.tracker import TrackedUnit, Tracker, graph_of
from tests.fakes.until import until


class World:
    """One container that is unhealthy until `fix` is called; the executor on a fake clock around it."""

    def __init__(self, *, armed: bool = False, container: ContainerSettings | None = None, **recovery: Any) -> None:
        self.clock = testing.FakeClock()
        self.events: list[Event] = []
        self.runs: list[str] = []
        self.alone: list[bool] = []
        self.behave: Callable[[str], None] = lambda name: self.fix()
        self.healthy, self.condition = False, "unhealthy"
        app = container or ContainerSettings(name="app", recover=True)
        self.settings = Settings.model_validate({"containers": [app], "recovery": recovery})
        unit = Unit("health/app", target="app")
        self.nodes_healthy = True
        nodes = Unit("nodes/app", ("health/app",), target="app")
        tracked = [
            TrackedUnit(unit, "health", Slot.CONTAINER, Layer.DOCKER),
            TrackedUnit(nodes, "nodes", Slot.NODES, Layer.ROS, 1, nodes.needs),
        ]
        tracker = Tracker(tracked, graph_of(tracked), self.clock.stamp())
        self.bus = Bus(self.clock)
        self.pipeline = Pipeline(tracker, self.bus, self.clock)
        self.pipeline.attach(lambda units, reason: self.observe())
        context = ActionContext(
            cast(Any, SimpleNamespace(inspect=None)),
            action_settings(self.settings),
            lambda key: None,
            lambda: None,
            lambda a, b: None,
        )
        state = (
            ArmedStatus(ArmedState.ARMED, "the autopilot is armed")
            if armed
            else ArmedStatus(ArmedState.DISARMED, "it is disarmed")
        )
        self.hangs = self._at_work = self._entered = False
        """Whether an action may wait in real time; whether the worker waits for one, and whether that has begun to run."""
        actions = self.actions = {name: self._action(name) for name in ("restart", "start")}
        self.executor = Executor(
            self.pipeline, self.publish, self.clock, actions, context, lambda: state, lambda unit: 0.0
        )
        self.bus.subscribe("recovery", self.executor.handle, kinds=Executor.kinds, key=Executor.key)
        self.bus.subscribe("test", self.events.append)

    def _action(self, action: str) -> type[Action]:
        world = self

        class Scripted(Action):
            name = action
            deadline_s = 5.0
            verify_after_s = 2.0

            def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
                world._entered = True
                world.runs.append(action)
                world.alone.append(context.alone)
                world.behave(action)
                return f"{action}ed"

        return Scripted

    def publish(self, event: Event) -> None:
        """Published by the worker's own thread: from STARTED until it knows the result, a thread runs the action."""
        if isinstance(event, ActionEvent):
            self._at_work, self._entered = event.phase is Phase.STARTED, False
        self.bus.publish(event)

    def fix(self) -> None:
        self.healthy = True

    def observe(self) -> None:
        bad = error("it is bad", brief="bad", condition=self.condition, target="app")
        lost = error("no nodes", brief="no nodes", condition="node_missing", target="app")
        results = {
            "health/app": ok("healthy") if self.healthy else bad,
            "nodes/app": ok("there") if self.nodes_healthy else lost,
        }
        self.pipeline.observe(results, self.clock.mono(), 0.0)

    def fail(self) -> None:
        self.healthy = False
        self.observe()

    def until(self, condition: Callable[[], bool]) -> None:
        """Let fake time pass, with regular checks of the unit, until `condition` is true."""
        until(condition, "the executor", self.phases, step=self._step)

    def _step(self) -> None:
        self.clock.advance(0.05)
        self.observe()
        until(self._is_idle, "all threads to be idle", poll_s=0.0002)

    def _is_idle(self) -> bool:
        """Whether the threads of the bus and of recovery sleep, and no action runs: a busy machine may delay each of them."""
        awake = len(self.bus._subscriptions) + len(self.executor._workers) - self.clock.sleepers
        return awake <= 0 and (not self._at_work or (self.hangs and self._entered))

    def phases(self) -> list[Phase]:
        return [event.phase for event in self.events if isinstance(event, ActionEvent)]

    def closed(self) -> list[FaultClosed]:
        return [event for event in self.events if isinstance(event, FaultClosed)]


@pytest.fixture
def worlds() -> Iterator[list[World]]:
    """Worlds made by a test, ended with it."""
    made: list[World] = []
    yield made
    for world in made:
        world.executor.stop()
        world.clock.advance(1000)


def make(worlds: list[World], **more: Any) -> World:
    worlds.append(World(**more))
    return worlds[-1]


def test_a_fault_is_acted_on_and_the_result_is_verified(worlds: list[World]) -> None:
    """Started, done, verified; the fault is resolved by the action."""
    world = make(worlds)
    world.fail()
    world.until(lambda: Phase.VERIFIED in world.phases() and world.closed())
    for _ in range(100):
        world.clock.advance(0.05)
        world.observe()
        until(lambda: world.clock.sleepers, "the worker to be idle")
    assert world.phases() == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    assert world.runs == ["restart"]
    assert world.closed()[0].fault.by == "restart"


def test_nothing_is_begun_once_recovery_has_stopped(worlds: list[World]) -> None:
    """Checks still run for a moment: a fault that opens then, or a request, is for the next PHM."""
    world = make(worlds)
    world.executor.stop()
    world.fail()
    for _ in range(20):
        world._step()
    with pytest.raises(NotNow, match="PHM is being stopped"):
        world.executor.restart("app", "an operator")
    assert world.runs == world.phases() == []
    assert world.executor._worker("app")._stopping


def test_an_ineffective_action_is_repeated_and_then_given_up(worlds: list[World]) -> None:
    """Three times the same failure: reported once, with the next step, and no more restarts."""
    world = make(worlds)
    world.behave = lambda name: None
    world.fail()
    world.until(lambda: Phase.ESCALATED in world.phases())
    assert world.runs == ["restart"] * 3
    assert world.phases().count(Phase.ESCALATED) == 1
    assert world.closed()[-1].fault.outcome.value == "escalated"
    detail = [event.detail for event in world.events if isinstance(event, ActionEvent)][-1]
    assert "docker logs" in detail
    for _ in range(200):
        world.clock.advance(1.0)
        world.observe()
    assert world.runs == ["restart"] * 3


def test_a_container_given_up_while_down_is_started_again_without_a_new_alarm(worlds: list[World]) -> None:
    """Once per maximum back-off; a start that does not last changes no published state, a lasting one ends it. Its dependents, which
    run, are not restarted each time."""
    world = make(worlds, backoff_max=60)
    world.condition, world.nodes_healthy = "exited", False
    world.behave = lambda name: None
    world.fail()
    world.until(lambda: Phase.ESCALATED in world.phases())
    assert world.runs == ["start", "restart", "restart"]

    def up_for_a_moment(name: str) -> None:
        world.healthy = True

    world.behave = up_for_a_moment
    world.until(lambda: len(world.runs) == 4)
    world.until(lambda: world.phases()[-1] is Phase.DONE)
    world.fail()
    world.until(lambda: world.phases()[-1] is Phase.FAILED)
    world.nodes_healthy = True
    world.until(lambda: len(world.runs) == 5)
    world.until(lambda: world.phases()[-1] is Phase.VERIFIED)
    assert world.runs[3:] == ["start", "start"]
    assert world.alone == [False] * 3 + [True] * 2
    assert world.phases().count(Phase.ESCALATED) == 1
    assert len([event for event in world.events if isinstance(event, FaultOpened)]) == 1
    world.until(lambda: world.pipeline.states()[0].level is Level.OK)


def test_a_refusal_is_reported_once_and_not_tried_again(worlds: list[World]) -> None:
    """403 from the engine: recovery is not permitted, report only."""
    world = make(worlds)

    def refuse(name: str) -> None:
        raise NotPermitted("the engine answered 403")

    world.behave = refuse
    world.fail()
    world.until(lambda: Phase.FAILED in world.phases())
    for _ in range(100):
        world.clock.advance(1.0)
        world.observe()
    assert world.runs == ["restart"]
    assert "recovery is not permitted" in [e.detail for e in world.events if isinstance(e, ActionEvent)][-1]


@pytest.mark.parametrize("trouble", [ActionFailed("no such network"), ValueError("boom"), SystemExit(1)])
def test_an_action_that_raises_is_a_failed_attempt(worlds: list[World], trouble: BaseException) -> None:
    """A plug-in's crash is reported and counted; the thread survives and tries again."""
    world = make(worlds)
    troubles = [trouble]

    def raise_once(name: str) -> None:
        if troubles:
            raise troubles.pop()
        world.fix()

    world.behave = raise_once
    world.fail()
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert world.phases() == [Phase.STARTED, Phase.FAILED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


@pytest.mark.parametrize("method", ["__init__", "applies", "waits_for", "limit_s"])
def test_an_action_that_exits_before_it_is_begun_does_not_end_recovery(worlds: list[World], method: str) -> None:
    """`sys.exit` of a plug-in, once, outside of `run`: the worker's thread goes on."""
    world = make(worlds)
    action = world.actions["restart"]
    proper = getattr(action, method)

    def leave(*given: object, **named: object) -> None:
        setattr(action, method, proper)
        sys.exit(1)

    setattr(action, method, leave)
    world.fail()
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert world.runs == ["restart"]


class Stuck:
    """The first action on the container does not return before `go`; every later one helps. `most`: actions at the same time."""

    def __init__(self, world: World) -> None:
        self.world, self.go, self.most = world, threading.Event(), 0
        self._running = 0
        world.behave, world.hangs = self._act, True

    def _act(self, name: str) -> None:
        self._running += 1
        self.most = max(self.most, self._running)
        if len(self.world.runs) == 1:
            self.go.wait(600)
        else:
            self.world.fix()
        self._running -= 1


def test_an_action_that_outlasts_its_deadline_is_alone_on_its_target(worlds: list[World]) -> None:
    """The attempt fails at the deadline, and the next one begins once the action has returned: both would act on one container."""
    world = make(worlds)
    stuck = Stuck(world)
    world.fail()
    world.until(lambda: Phase.REFUSED in world.phases())
    for _ in range(60):
        world.clock.advance(1.0)
        world.observe()
    details = [event.detail for event in world.events if isinstance(event, ActionEvent)]
    assert world.phases() == [Phase.STARTED, Phase.FAILED, Phase.REFUSED]
    assert "within 5 s" in details[1] and "an earlier restart for health/app still runs" in details[2]
    stuck.go.set()
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert (world.runs, stuck.most) == (["restart"] * 2, 1)


def test_an_action_that_never_returns_blocks_its_target_for_a_limited_time(worlds: list[World]) -> None:
    """No call of the engine lasts that long, so it hangs in code of a plug-in: the next attempt follows."""
    world = make(worlds)
    stuck = Stuck(world)
    world.fail()
    world.until(lambda: Phase.REFUSED in world.phases())
    world.clock.advance(HUNG_S)
    world.until(lambda: Phase.VERIFIED in world.phases())
    stuck.go.set()
    assert world.runs == ["restart"] * 2


@pytest.mark.parametrize("recovery", [{"mode": "advise"}, {"mode": "off"}])
def test_modes_advise_and_off_take_no_action(worlds: list[World], recovery: dict[str, str]) -> None:
    """`advise` reports the recommended action, once; `off` reports nothing."""
    world = make(worlds, **recovery)
    world.fail()
    world.until(lambda: any(isinstance(event, FaultOpened) for event in world.events))
    for _ in range(100):
        world.clock.advance(1.0)
        world.observe()
    assert world.runs == []
    world.until(lambda: world.phases() == ([Phase.ADVISED] if recovery["mode"] == "advise" else []))


def test_flight_critical_is_left_alone_while_armed(worlds: list[World]) -> None:
    """Only an advice, reported once, however long it lasts."""
    critical = ContainerSettings(name="app", recover=True, flight_critical=True)
    world = make(worlds, armed=True, container=critical)
    world.fail()
    world.until(lambda: world.phases() == [Phase.ADVISED])
    for _ in range(100):
        world.clock.advance(1.0)
    assert world.runs == []
    assert world.phases() == [Phase.ADVISED]


def test_a_spontaneous_recovery_ends_the_attempts(worlds: list[World]) -> None:
    """After the first failed attempt the fault clears during back-off: no action follows."""
    world = make(worlds, backoff=50, backoff_max=60)

    def refuse(name: str) -> None:
        raise ActionFailed("not now")

    world.behave = refuse
    world.fail()
    world.until(lambda: Phase.FAILED in world.phases())
    world.fix()
    world.until(lambda: bool(world.closed()))
    for _ in range(100):
        world.clock.advance(1.0)
        world.observe()
    assert world.runs == ["restart"]
    assert world.closed()[0].fault.by == "itself"


def test_a_step_that_does_not_apply_is_not_a_failed_attempt(worlds: list[World]) -> None:
    """A step without configuration is skipped: the first attempt is the first step that can help."""
    world = make(worlds, ladders={"unhealthy": ["start", "restart"]})
    cast(Any, world.actions["start"]).applies = classmethod(lambda cls, target, fault, settings: False)
    world.fail()
    world.until(lambda: Phase.VERIFIED in world.phases())
    assert world.runs == ["restart"]
    assert Phase.FAILED not in world.phases()


def test_an_action_that_leaves_dependents_down_is_followed_by_the_next_step(worlds: list[World]) -> None:
    """Recovered means that the target's dependents are OK, too; it stays one fault, and the next action resolves it."""
    world = make(worlds, ladders={"unhealthy": ["start", "restart"]})
    world.nodes_healthy = False

    def fix_in_part(name: str) -> None:
        world.fix()
        world.nodes_healthy = name == "restart"

    world.behave = fix_in_part
    world.fail()
    world.until(lambda: Phase.VERIFIED in world.phases() and world.closed())
    assert world.runs == ["start", "restart"]
    assert world.phases() == [Phase.STARTED, Phase.DONE, Phase.FAILED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    assert sum(isinstance(event, FaultOpened) for event in world.events) == 1
    assert [event.fault.by for event in world.closed()] == ["restart"]


def test_a_dependent_missing_after_the_last_step_is_a_separate_fault(worlds: list[World]) -> None:
    """No further action exists for this fault, which is resolved; the missing dependents are reported as separate
    faults.
    """
    world = make(worlds)
    world.nodes_healthy = False
    world.fail()
    world.until(
        lambda: any(isinstance(event, FaultOpened) and event.fault.unit == "nodes/app" for event in world.events)
    )
    assert world.closed()[0].fault.unit == "health/app"
