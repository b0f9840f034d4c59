"""A new PHM takes up what an earlier one left: tracker, executor and keeper together, on a fake clock."""

from __future__ import annotations

import threading
import time
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
from phm.recovery.base import Action, ActionContext
from phm.recovery.executor import Executor, NotApprovable
from phm.recovery.persistence.persistence_service import PersistenceService
from phm.recovery.safety.armed_state import ArmedState, ArmedStatus
from phm.recovery.target import Target
from phm.tracker import TrackedUnit, Tracker, graph_of
from tests.fakes.until import until

APP = "health/app"


class Life:
    """One life of PHM around one container; the next life gets the same folder and the same clock."""

    def __init__(self, folder: Path, clock: testing.FakeClock, *, units: tuple[str, ...] = (APP,), **more: Any) -> None:
        self.clock, self.well = clock, False
        self.events: list[Event] = []
        self.runs: list[str] = []
        self.behave: Callable[[str], None] = lambda name: None
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
        context = ActionContext(cast(Any, None), settings, lambda key: None, lambda: None, lambda a, b: None)
        self.executor = Executor(
            self.pipeline,
            self.bus.publish,
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
                life.runs.append("restart")
                life.behave("restart")
                return "restarted"

        return Restart

    def look(self) -> None:
        bad = error("unhealthy", brief="unhealthy", condition="unhealthy", target="app")
        for unit in self.units:
            self.pipeline.observe({unit: ok("healthy") if self.well else bad}, self.clock.mono(), 0.0)

    def until(self, condition: Callable[[], bool]) -> None:
        """Let fake time run, with the unit looked at all along, until something is seen."""
        until(condition, "recovery", lambda: self.events, step=self._step)

    def _step(self) -> None:
        self.clock.advance(0.05)
        self.look()
        time.sleep(0.001)

    def die(self) -> None:
        """SIGKILL, as far as a thread can: nothing more is kept."""
        self.memory.close()
        self.executor.stop()

    def of(self, kind: type) -> list[Any]:
        return [event for event in self.events if isinstance(event, kind)]

    def phases(self) -> list[Phase]:
        return [event.phase for event in self.of(ActionEvent)]

    def rest(self) -> None:
        """A long time passes, with the unit looked at."""
        for _ in range(100):
            self.clock.advance(1.0)
            self.look()


@pytest.fixture
def lives(tmp_path: Path) -> Iterator[Callable[..., Life]]:
    clock = testing.FakeClock()
    made: list[Life] = []

    def live(**more: Any) -> Life:
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


def test_an_open_fault_is_taken_up_without_a_second_alarm(lives: Callable[..., Life]) -> None:
    """Same id, ERROR at once and said to be restored; nothing is opened, reported or advised again; it closes once."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise")
    state = second.pipeline.states()[0]
    assert (state.level, state.fault) == (Level.ERROR, fault.id)
    assert state.result.summary == "restored after a restart of PHM: unhealthy"
    second.rest()
    assert second.pipeline.states()[0].result.summary == "unhealthy"
    assert second.of(FaultOpened) == second.of(Transition) == second.phases() == []
    second.well = True
    second.until(lambda: bool(second.of(FaultClosed)))
    assert [event.fault.id for event in second.of(FaultClosed)] == [fault.id]


def test_new_faults_get_ids_of_their_own(lives: Callable[..., Life]) -> None:
    """Both lives count from one with the same prefix: what is restored is stepped over."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise", units=(APP, "health/other"))
    second.until(lambda: bool(second.of(FaultOpened)))
    assert second.of(FaultOpened)[0].fault.id not in ("", fault.id)


def test_attempts_count_over_a_restart_and_what_was_given_up_stays_so(lives: Callable[..., Life]) -> None:
    """One attempt in each life makes two; a third life neither acts nor reports until the unit has been well."""
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
    third.well = True
    third.until(lambda: third.pipeline.states()[0].level is Level.OK)
    assert third.pipeline.given_up() == ()


def test_an_action_that_was_cut_short_is_an_attempt_and_taken_up_again(lives: Callable[..., Life]) -> None:
    """The state says that it had started: noted, counted, and done again once the fault is seen to last."""
    first, stuck = lives(same_failure=5), threading.Event()
    first.behave = lambda name: cast(None, stuck.wait(30))
    first.until(lambda: bool(first.runs))
    first.die()
    second = lives(same_failure=5)
    stuck.set()
    second.behave = lambda name: setattr(second, "well", True)
    second.until(lambda: Phase.VERIFIED in second.phases())
    assert any("interrupted" in event.text for event in second.of(Note))
    assert second.of(FaultOpened) == []
    assert [made.worked for made in second.executor.persisted().attempts["app"]] == [False, True]


def test_what_healed_meanwhile_is_not_acted_on(lives: Callable[..., Life]) -> None:
    """The first fresh result decides: the cut-short action worked after all, and gets the credit."""
    first, stuck = lives(), threading.Event()
    first.behave = lambda name: cast(None, stuck.wait(30))
    first.until(lambda: bool(first.runs))
    first.die()
    second = lives()
    second.well = True
    second.until(lambda: bool(second.of(FaultClosed)))
    stuck.set()
    second.rest()
    assert second.runs == []
    assert second.of(FaultClosed)[0].fault.by == "restart"


def test_a_unit_that_is_no_longer_configured_drops_its_fault(lives: Callable[..., Life]) -> None:
    """Reported once, as resolved by the configuration."""
    fault = advised(lives(mode="advise"))
    second = lives(mode="advise", units=("health/other",))
    second.until(lambda: bool(second.of(FaultClosed)))
    closed = second.of(FaultClosed)[0].fault
    assert (closed.id, closed.outcome.value, closed.by) == (fault.id, "resolved", "configuration")


def test_a_folder_that_cannot_be_written_is_a_problem_and_nothing_else(tmp_path: Path) -> None:
    """Healing goes on; `phm status` says what does not work."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    life = Life(blocked, testing.FakeClock())
    life.behave = lambda name: setattr(life, "well", True)
    life.until(lambda: Phase.VERIFIED in life.phases() and bool(life.memory.problem()))
    assert "cannot write" in life.memory.problem()
    life.die()


# ---------------------------------------------------------------- the operator's yes


def test_an_approval_holds_for_one_action(lives: Callable[..., Life]) -> None:
    """Approved, done once although recovery only advises, and advised again when it did not help."""
    life = lives(mode="advise", same_failure=5)
    life.until(lambda: Phase.ADVISED in life.phases())
    assert life.executor.approve(life.of(FaultOpened)[0].fault.id) == "approved: restart app for health/app"
    life.until(lambda: life.phases().count(Phase.ADVISED) == 2)
    life.rest()
    assert life.runs == ["restart"]
    expected = [Phase.ADVISED, Phase.APPROVED, Phase.STARTED, Phase.DONE, Phase.FAILED, Phase.ADVISED]
    assert life.phases() == expected


def test_there_must_be_something_to_approve(lives: Callable[..., Life]) -> None:
    """No such fault: the open ones are named; a fault that is being healed needs no yes."""
    life = lives(backoff=50, backoff_max=60, same_failure=5)
    with pytest.raises(NotApprovable, match="no open fault F9; open: none"):
        life.executor.approve("F9")
    life.until(lambda: Phase.FAILED in life.phases())
    (fault,) = life.pipeline.open_faults()
    with pytest.raises(NotApprovable, match=f"open: {fault.id} \\(health/app\\)"):
        life.executor.approve("F9")
    with pytest.raises(NotApprovable, match=r"nothing is advised for .*: backing off"):
        life.executor.approve(fault.id)
