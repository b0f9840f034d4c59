"""A new PHM resumes with the saved state: tracker, executor and persistence together, on a fake clock."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from phm import testing
from phm.api import Layer, Slot, Unit, error, ok
from phm.checking.pipeline import Pipeline
from phm.core.bus import Bus
from phm.core.model import ActionEvent, Event, Fault, FaultClosed, FaultOpened, Level, Note, Phase, Transition
from phm.core.settings import ContainerSettings, Settings
from phm.facts import NotPermitted
from phm.recovery.base import Action, ActionContext, Target
from phm.recovery.executor import Executor, NotApprovable
from phm.recovery.persistence.persistence_service import PersistenceService
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.runtime.sections import action_settings
from phm.tracker import TrackedUnit, Tracker, graph_of
from tests.fakes.until import LIMIT_S, until

APP = "health/app"


class Life:
    """One life of PHM around one container; the next life gets the same directory and clock."""

    def __init__(self, folder: Path, clock: testing.FakeClock, *, units: tuple[str, ...] = (APP,), **more: Any) -> None:
        self.clock, self.healthy = clock, False
        self.events: list[Event] = []
        self.runs: list[str] = []
        self.behave: Callable[[str], None] = lambda name: None
        self.hangs = self._at_work = self._entered = False
        """Whether an action may wait in real time; whether the worker waits for one, and whether that has begun to run."""
        recovery = {"ladders": {"unhealthy": ["restart"]}, "same_failure": 2, **more}
        app = ContainerSettings(name="app", recover=True)
        settings = Settings.model_validate({"containers": [app], "recovery": recovery, "state_dir": str(folder)})
        tracked = [TrackedUnit(Unit(unit, target="app"), "health", Slot.CONTAINER, Layer.DOCKER) for unit in units]
        self.bus = Bus(clock)
        self.pipeline = Pipeline(Tracker(tracked, graph_of(tracked), clock.stamp()), self.bus, clock)
        self.units = units
        self.memory = PersistenceService(str(folder), settings.recovery.window, self.pipeline, self.bus, clock)
        self.memory.restore()
        self.bus.subscribe("test", self.events.append)
        context = ActionContext(
            cast(Any, None), action_settings(settings), lambda key: None, lambda: None, lambda a, b: None
        )
        self.executor = Executor(
            self.pipeline,
            self._publish,
            clock,
            {"restart": self._action()},
            context,
            lambda: ArmedStatus(ArmedState.DISARMED, "the autopilot is disarmed"),
            lambda unit: 0.0,
        )
        self.memory.resume(self.executor)
        self.bus.subscribe("recovery", self.executor.handle, kinds=Executor.kinds, key=Executor.key)

    def _action(self) -> type[Action]:
        life = self

        class Restart(Action):
            name = "restart"
            deadline_s = 5.0

            def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
                life._entered = True
                life.runs.append("restart")
                life.behave("restart")
                return "restarted"

        return Restart

    def observe(self) -> None:
        bad = error("unhealthy", brief="unhealthy", condition="unhealthy", target="app")
        for unit in self.units:
            self.pipeline.observe({unit: ok("healthy") if self.healthy else bad}, self.clock.mono(), 0.0)

    def until(self, condition: Callable[[], bool]) -> None:
        """Let fake time pass, with regular checks of the unit, until `condition` is true."""
        until(condition, "recovery", lambda: self.events, step=self._step)

    def _publish(self, event: Event) -> None:
        """Published by the worker's own thread: from STARTED until it knows the result, a thread runs the action."""
        if isinstance(event, ActionEvent):
            self._at_work, self._entered = event.phase is Phase.STARTED, False
        self.bus.publish(event)

    def _step(self) -> None:
        self.clock.advance(0.05)
        self.observe()
        until(self._is_idle, "all threads to be idle", poll_s=0.0002)

    def _is_idle(self) -> bool:
        """Whether the threads of the bus and of recovery sleep, and no action runs: a busy machine may delay each of them."""
        awake = len(self.bus._subscriptions) + len(self.executor._workers) - self.clock.sleepers
        return awake <= 0 and (not self._at_work or (self.hangs and self._entered))

    def die(self) -> None:
        """SIGKILL, as far as a thread can simulate it: nothing more is saved."""
        self.memory.close()
        self.executor.stop()

    def of(self, kind: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    def phases(self) -> list[Phase]:
        return [event.phase for event in self.of(ActionEvent)]

    def rest(self) -> None:
        """A long time passes, with regular checks of the unit."""
        for _ in range(100):
            self.clock.advance(1.0)
            self.observe()


@pytest.fixture
def lives(tmp_path: Path) -> Iterator[Callable[..., Life]]:
    clock = testing.FakeClock()
    made: list[Life] = []

    def live(**more: Any) -> Life:
        if made:
            made[-1].bus.close(LIMIT_S)  # else both write the state
        made.append(Life(tmp_path, clock, **more))
        return made[-1]

    yield live
    for life in made:
        life.executor.stop()
    clock.advance(1000)


def advised(life: Life) -> Fault:
    life.until(lambda: Phase.ADVISED in life.phases())
    fault: Fault = life.of(FaultOpened)[0].fault
    life.die()
    return fault


def test_an_open_fault_is_restored_without_a_second_alarm(lives: Callable[..., Life]) -> None:
    """Same id, ERROR immediately and marked as restored; nothing is opened, reported or advised again; it closes once."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise")
    state = second.pipeline.states()[0]
    assert (state.level, state.fault) == (Level.ERROR, fault.id)
    assert state.result.summary == "restored after a restart of PHM: unhealthy"
    second.rest()
    assert second.pipeline.states()[0].result.summary == "unhealthy"
    assert second.of(FaultOpened) == second.of(Transition) == second.phases() == []
    second.healthy = True
    second.until(lambda: bool(second.of(FaultClosed)))
    assert [event.fault.id for event in second.of(FaultClosed)] == [fault.id]


def test_reporters_know_what_waits_for_the_operator_over_restarts(lives: Callable[..., Life]) -> None:
    """Recovery does not publish it again. An advice until it is approved; a fault that recovery has given up on."""
    fault = advised(lives(mode="advise"))
    for _ in range(2):
        life = lives(mode="advise", same_failure=1)
        (request,) = life.memory.requests()
        assert (request.fault, request.unit, request.action) == (fault.id, fault.unit, "restart")
        assert (request.target, request.phase) == ("app", Phase.ADVISED)
        life.rest()
        life.die()
    life = lives(mode="advise", same_failure=1)
    life.until(lambda: life.pipeline.confirmed_bad(APP, life.clock.mono() - 1.0))
    life.executor.approve(fault.id)
    assert life.executor.persisted().cases[fault.id].advised == ""
    life.until(lambda: Phase.ESCALATED in life.phases())
    life.die()
    assert [(each.fault, each.phase) for each in lives().memory.requests()] == [(fault.id, Phase.ESCALATED)]


def test_new_faults_get_unused_ids(lives: Callable[..., Life]) -> None:
    """Both lives count from one with the same prefix: restored numbers are skipped."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise", units=(APP, "health/other"))
    second.until(lambda: bool(second.of(FaultOpened)))
    assert second.of(FaultOpened)[0].fault.id not in ("", fault.id)


def test_the_numbers_of_faults_go_on_after_a_restart(lives: Callable[..., Life]) -> None:
    """Also when no fault is open: an operator may still approve by the number in an earlier line."""
    first = lives(mode="advise")
    first.until(lambda: bool(first.of(FaultOpened)))
    first.healthy = True
    first.until(lambda: bool(first.of(FaultClosed)))
    first.die()
    second = lives(mode="advise")
    second.until(lambda: bool(second.of(FaultOpened)))
    assert [life.of(FaultOpened)[0].fault.id for life in (first, second)] == ["F1", "F2"]


def test_attempts_and_giving_up_survive_a_restart(lives: Callable[..., Life]) -> None:
    """One attempt in each life makes two; a third life neither acts nor reports until the unit was OK."""
    first = lives(backoff=20)
    first.until(lambda: Phase.FAILED in first.phases())
    first.die()
    second = lives(backoff=20)
    second.until(lambda: Phase.ESCALATED in second.phases())
    assert second.runs == ["restart"]
    second.die()
    third = lives()
    third.rest()
    assert third.runs == third.of(FaultOpened) == third.phases() == []
    assert third.pipeline.states()[0].level is Level.ERROR
    third.healthy = True
    third.until(lambda: third.pipeline.states()[0].level is Level.OK)
    assert third.pipeline.given_up() == ()


def test_an_interrupted_action_is_an_attempt_and_repeated(lives: Callable[..., Life]) -> None:
    """The state says that it had started: reported, counted, and repeated once the fault is seen to last."""
    first, stuck = lives(same_failure=5), threading.Event()
    first.hangs, first.behave = True, lambda name: cast(None, stuck.wait(120))
    first.until(lambda: bool(first.runs))
    first.die()
    second = lives(same_failure=5)
    stuck.set()
    second.behave = lambda name: setattr(second, "healthy", True)
    second.until(lambda: Phase.VERIFIED in second.phases())
    assert any("interrupted" in event.text for event in second.of(Note))
    assert second.of(FaultOpened) == []
    assert [made.worked for made in second.executor.persisted().attempts["app"]] == [False, True]


def test_an_action_that_was_not_permitted_is_tried_again(lives: Callable[..., Life]) -> None:
    """The operator corrects the socket proxy and restarts PHM."""

    def refuse(name: str) -> None:
        raise NotPermitted("HTTP 403")

    first = lives()
    first.behave = refuse
    first.until(lambda: Phase.FAILED in first.phases())
    first.rest()
    first.die()
    second = lives()
    second.behave = lambda name: setattr(second, "healthy", True)
    second.until(lambda: Phase.VERIFIED in second.phases())
    assert first.runs == second.runs == ["restart"]


@pytest.mark.parametrize("returned", [False, True])
def test_only_a_call_without_a_response_may_still_start_the_container(
    lives: Callable[..., Life], returned: bool
) -> None:
    """PHM is killed while it verifies an action that has returned: what is started later, or stopped, is somebody else's."""
    first, stuck = lives(same_failure=5), threading.Event()
    first.hangs = not returned
    first.behave = lambda name: None if returned else cast(None, stuck.wait(120))
    first.until(lambda: Phase.DONE in first.phases() if returned else bool(first.runs))
    first.die()
    second = lives(same_failure=5)
    assert second.executor.persisted().unfinished == ({} if returned else {"app": "app"})
    stuck.set()


def test_a_unit_that_recovered_meanwhile_is_not_acted_on(lives: Callable[..., Life]) -> None:
    """The first new result decides: the interrupted action did work, and gets the credit."""
    first, stuck = lives(), threading.Event()
    first.hangs, first.behave = True, lambda name: cast(None, stuck.wait(120))
    first.until(lambda: bool(first.runs))
    first.die()
    second = lives()
    second.healthy = True
    second.until(lambda: bool(second.of(FaultClosed)))
    stuck.set()
    second.rest()
    assert second.runs == []
    assert second.of(FaultClosed)[0].fault.by == "restart"


@pytest.mark.parametrize("first_seen_by", ["the bus", "the worker"])
def test_an_interrupted_action_ends_with_its_fault(lives: Callable[..., Life], first_seen_by: str) -> None:
    """Whichever thread sees that first: as long as the action lasts, other failures of the container are no faults."""
    first, stuck = lives(), threading.Event()
    first.hangs, first.behave = True, lambda name: cast(None, stuck.wait(120))
    first.until(lambda: bool(first.runs))
    first.die()
    second = lives()
    stuck.set()
    assert second.pipeline.action_on("app") == "restart"
    worker = second.executor._workers["app"]
    closed = worker.closed

    def late(fault: Fault) -> None:
        worker._current()
        closed(fault)

    worker.closed = late if first_seen_by == "the worker" else closed  # type: ignore[method-assign]
    second.healthy = True
    second.until(lambda: bool(second.of(FaultClosed)))
    second._step()
    assert second.pipeline.action_on("app") == ""


def test_the_fault_of_a_removed_unit_is_closed(lives: Callable[..., Life]) -> None:
    """Reported once, as resolved by the configuration."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise", units=("health/other",))
    second.until(lambda: bool(second.of(FaultClosed)))
    closed = second.of(FaultClosed)[0].fault
    assert (closed.id, closed.outcome.value, closed.by) == (fault.id, "resolved", "configuration")


def test_an_unwritable_directory_is_only_a_problem(tmp_path: Path) -> None:
    """Recovery continues; `phm status` reports the problem."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    life = Life(blocked, testing.FakeClock())
    life.behave = lambda name: setattr(life, "healthy", True)
    life.until(lambda: Phase.VERIFIED in life.phases() and "cannot write" in life.memory.problem())
    life.die()


# ---------------------------------------------------------------- approval


def test_an_approval_is_valid_for_one_action(lives: Callable[..., Life]) -> None:
    """Approved, done once although recovery only advises, and advised again when it did not help."""
    life = lives(mode="advise", same_failure=5)
    life.until(lambda: Phase.ADVISED in life.phases())
    assert life.executor.approve(life.of(FaultOpened)[0].fault.id) == "approved: restart app for health/app"
    life.until(lambda: life.phases().count(Phase.ADVISED) == 2)
    life.rest()
    assert life.runs == ["restart"]
    expected = [Phase.ADVISED, Phase.APPROVED, Phase.STARTED, Phase.DONE, Phase.FAILED, Phase.ADVISED]
    assert life.phases() == expected


def test_an_approval_without_an_advised_action_is_denied(lives: Callable[..., Life]) -> None:
    """No such fault: the open ones are named; a fault that is being recovered needs no approval."""
    life = lives(backoff=50, backoff_max=60, same_failure=5)
    with pytest.raises(NotApprovable, match="no open fault F9; open: none"):
        life.executor.approve("F9")
    life.until(lambda: Phase.FAILED in life.phases())
    (fault,) = life.pipeline.open_faults()
    with pytest.raises(NotApprovable, match=f"open: {fault.id} \\(health/app\\)"):
        life.executor.approve("F9")
    with pytest.raises(NotApprovable, match=r"nothing is advised for .*: backing off"):
        life.executor.approve(fault.id)


def test_a_lost_state_is_reported_for_a_moment(lives: Callable[..., Life], tmp_path: Path) -> None:
    """Holds and budgets are forgotten, which an operator must learn: not only by a line in the log."""
    (tmp_path / "state.json").write_bytes(bytes(range(256)))
    life = lives()
    assert "is invalid (it is not JSON); renamed to state.json.corrupt-" in life.memory.problem()
    life.clock.advance(13.0)
    assert life.memory.problem() == ""
    assert lives().memory.problem() == ""
