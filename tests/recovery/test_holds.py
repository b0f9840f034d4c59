"""Holds in a running PHM, on a fake clock: what begins and ends them, and what the rest of PHM makes of them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import FaultClosed, HoldChanged, Level, Outcome, Phase, Stamp
from phm.facts import COMPLETE, EventStreamFact
from phm.probes.docker_events import DockerEvent
from phm.recovery.executor import NotApprovable, NotNow
from phm.recovery.holds.hold_registry import ALL, Hold, HoldRegistry
from phm.recovery.holds.hold_service import CLOSED_S, LABELS_S, HoldInputs, HoldRefused, HoldService
from phm.recovery.persistence.state import InvalidState, PersistedState, RecoveryState, decode, encode
from phm.recovery.safety.armed_state import ArmedState as ArmedState, ArmedStatus, LastArmedState
from phm.runtime.daemon import Daemon
from phm.testing import FakeClock, settings
from tests.recovery.agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "nodes/app": Of("app", ("container/app",)), "container/cam": Of("cam")}
LADDERS = {"broken": ["restart"], "exited": ["restart"]}
PATIENT = {"backoff": 50.0, "backoff_max": 60.0}
BY = "operator (uid 0)"
STOP = (("kill", "signal 15"), ("die", "exit code 0"), ("stop", ""))


class Scene:
    """PHM with two containers, of which `app` is flight-critical. `armed` is what is known of the vehicle."""

    def __init__(
        self,
        folder: Path | None = None,
        clock: FakeClock | None = None,
        containers: Containers | None = None,
        bad: dict[str, str] | None = None,
        **recovery: Any,
    ) -> None:
        self.clock, self.containers = clock or FakeClock(), containers or Containers("app", "cam")
        self.armed = ArmedState.DISARMED
        self.agent = Agent(
            UNITS,
            self.containers,
            self.clock,
            folder=folder,
            opted_in=("app", "cam"),
            critical=("app",),
            **{"ladders": LADDERS, **recovery},
        )
        self.holds: HoldRegistry = self.agent.executor.holds
        action_on = self.agent.executor.action_on
        self.stream = COMPLETE
        world = HoldInputs(
            lambda: ArmedStatus(self.armed, "as the test says"),
            self.containers.facts.get,
            action_on,
            lambda: self.stream,
        )
        self.service = HoldService(
            self.agent.settings, self.holds, self.agent.pipeline, self.agent.bus.publish, self.clock, world
        )
        self.service._apply(("app", "cam"))
        look = self.agent.look
        self.agent.look = lambda: (self.service.tick(), look())[1]  # type: ignore[method-assign]
        self.agent.bad = bad or {}
        self.agent.rest(0.5)

    def hold(self, container: str = "app", for_s: float | None = 60.0, reason: str = "new firmware") -> str:
        return self.service.hold(container, for_s, reason, BY)[0]

    def happen(self, *events: tuple[str, str], key: str = "app") -> None:
        for action, detail in events:
            self.service.happened(key, action, detail)

    def level(self, unit: str = "container/app") -> Level:
        return next(state.level for state in self.agent.pipeline.states() if state.unit == unit)

    def summary(self, unit: str = "container/app") -> str:
        return next(state.result.summary for state in self.agent.pipeline.states() if state.unit == unit)

    def changes(self) -> list[tuple[str, bool]]:
        return [(event.target, event.began) for event in self.agent.of(HoldChanged)]

    def last(self) -> str:
        found: HoldChanged = self.agent.of(HoldChanged)[-1]
        return found.text

    def stop(self) -> None:
        self.agent.stop()
        self.clock.advance(1000)


@pytest.fixture
def scenes() -> Iterator[Any]:
    made: list[Scene] = []

    def make(*words: Any, **more: Any) -> Scene:
        made.append(Scene(*words, **more))
        return made[-1]

    yield make
    for scene in made:
        scene.stop()


@pytest.fixture
def scene(scenes: Any) -> Scene:
    made: Scene = scenes()
    return made


# ---------------------------------------------------------------- what a hold does


def test_what_is_bad_on_hold_is_stale_and_no_alarm(scene: Scene) -> None:
    """With until when, by whom and why; nothing is done about it, and what follows from it is quiet, too."""
    scene.hold()
    scene.agent.bad = {"container/app": "broken", "nodes/app": "broken"}
    scene.agent.rest(5)
    assert scene.level() is scene.level("nodes/app") is Level.STALE
    assert "on hold until" in scene.summary() and BY in scene.summary() and "new firmware" in scene.summary()
    assert scene.agent.opened() == [] and scene.agent.runs == []


def test_other_containers_are_not_affected(scene: Scene) -> None:
    """A hold is on one container, unless it is on all."""
    scene.hold("app")
    scene.agent.bad = {"container/cam": "broken"}
    scene.agent.until(lambda: ("cam", "container/cam") in scene.agent.runs, "the restart of cam")


def test_a_hold_without_a_container_is_on_all(scene: Scene) -> None:
    """And `phm release` without one ends it."""
    scene.hold(ALL)
    scene.agent.bad = {"container/app": "broken", "container/cam": "broken"}
    scene.agent.rest(5)
    assert scene.agent.opened() == []
    scene.agent.bad = {}
    scene.service.release(ALL, BY)
    assert scene.service.snapshot() == []


def test_what_is_well_on_hold_is_well(scene: Scene) -> None:
    """A hold hides nothing that is OK."""
    scene.hold()
    scene.agent.rest(1)
    assert scene.level() is Level.OK


def test_a_hold_ends_by_itself_with_a_message(scene: Scene) -> None:
    """Then what is still bad is a fault and healed."""
    scene.hold(for_s=10)
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.rest(9)
    assert scene.agent.opened() == []
    scene.agent.until(lambda: scene.agent.runs, "the restart")
    assert scene.changes() == [("app", True), ("app", False)] and "its time is over" in scene.last()
    assert scene.agent.opened() == ["container/app"]


def test_an_open_fault_stays_open_without_an_action(scenes: Any) -> None:
    """It is listed while it is on hold, its attempts stay as they are, and it is healed after a fresh finding."""
    scene = scenes(**PATIENT)
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold(for_s=120)
    scene.agent.rest(100)
    assert len(scene.agent.runs) == 1 and scene.level() is Level.STALE
    assert [fault.unit for fault in scene.agent.pipeline.open_faults()] == ["container/app"]
    refused = [event.detail for event in scene.agent.actions() if event.phase is Phase.REFUSED]
    assert len(refused) == 1 and "on hold until" in refused[0]
    scene.agent.until(lambda: scene.agent.steps().count(Phase.STARTED) == 2, "the next attempt")
    assert scene.agent.opened() == ["container/app"]
    assert [event.attempt for event in scene.agent.actions() if event.phase is Phase.STARTED] == [1, 2]


def test_a_fault_that_ends_on_hold_is_resolved(scenes: Any) -> None:
    """By itself, as far as PHM is concerned."""
    scene = scenes(**PATIENT)
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold()
    scene.agent.rest(1)
    scene.agent.bad = {}
    scene.agent.until(lambda: scene.agent.closed(), "the end of the fault")
    closed: FaultClosed = scene.agent.closed()[0]
    assert (closed.fault.outcome, closed.fault.by) == (Outcome.RESOLVED, "itself")


def test_after_a_hold_nothing_is_done_on_an_old_finding(scenes: Any) -> None:
    """The operator has mended it in the last moment: no action follows."""
    scene = scenes(**PATIENT)
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold(for_s=30)
    scene.agent.rest(29)
    scene.agent.bad = {}
    scene.agent.rest(30)
    assert len(scene.agent.runs) == 1


def test_an_action_under_way_is_finished_first(scene: Scene) -> None:
    """The answer to the operator names it."""
    answers: list[str] = []

    def slow(key: str, context: Any, fault: Any) -> None:
        answers.append(scene.hold())
        scene.containers.start(key)
        scene.agent.bad = {}

    scene.agent.behave = slow
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: Phase.VERIFIED in scene.agent.steps(), "the verification")
    assert "restart of app, which is under way, is finished first" in answers[0]


def test_on_hold_nothing_is_approved_and_nothing_restarted_for_the_ground(scene: Scene) -> None:
    """Whoever asks is told until when it is on hold."""
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold()
    fault = scene.agent.pipeline.open_faults()[0].id
    with pytest.raises(NotApprovable, match="on hold until"):
        scene.agent.executor.approve(fault)
    with pytest.raises(NotNow, match="on hold until"):
        scene.agent.executor.restart("app", "the ground")


# ---------------------------------------------------------------- what is granted


@pytest.mark.parametrize(
    ("container", "for_s", "why"),
    [
        ("ap", 60.0, "no container 'ap'"),
        ("app", 0.5, "1 s to 14400 s"),
        ("app", 20000.0, "recovery.hold_max"),
        ("app", float("nan"), "recovery.hold_max"),
    ],
)
def test_a_bad_hold_is_refused(scene: Scene, container: str, for_s: float, why: str) -> None:
    """With what is allowed."""
    with pytest.raises(HoldRefused, match=why):
        scene.hold(container, for_s)


def test_a_second_hold_takes_the_place_of_the_first(scene: Scene) -> None:
    """Also to shorten it."""
    scene.hold(for_s=600)
    scene.hold(for_s=10, reason="")
    assert [(hold["left_s"], hold["reason"]) for hold in scene.service.snapshot()] == [(10.0, "")]


def test_a_release_of_nothing_is_refused(scene: Scene) -> None:
    """And says when it is the hold on all that keeps it."""
    with pytest.raises(HoldRefused, match=r"app is not on hold$"):
        scene.service.release("app", BY)
    scene.hold(ALL)
    with pytest.raises(HoldRefused, match="all containers are on hold"):
        scene.service.release("app", BY)


def test_a_clock_that_is_set_changes_no_hold(scene: Scene) -> None:
    """The end is on the monotonic clock."""
    scene.hold(for_s=10)
    scene.agent.bad = {"container/app": "broken"}
    scene.clock.jump_utc(-86400)
    scene.agent.rest(5)
    scene.clock.jump_utc(10 * 86400)
    scene.agent.rest(4)
    assert scene.agent.opened() == []
    scene.agent.rest(3)
    assert scene.agent.opened() == ["container/app"]


# ---------------------------------------------------------------- in the air


@pytest.mark.parametrize("container", ["app", ALL])
def test_what_is_flight_critical_is_not_put_on_hold_while_armed(scene: Scene, container: str) -> None:
    """Its failures stay visible; another container may be."""
    scene.armed = ArmedState.ARMED
    with pytest.raises(HoldRefused, match="flight-critical"):
        scene.hold(container)
    scene.hold("cam")


def shared_network(scene: Scene) -> None:
    """app lives in the network of cam."""
    scene.containers.facts["app"] = replace(scene.containers.facts["app"], network_mode="container:cam")
    scene.agent.rest(2 * LABELS_S)


def test_what_takes_a_flight_critical_container_down_is_not_put_on_hold_while_armed(scene: Scene) -> None:
    """Its failure would take down the critical one, and must stay visible as well; a hold from before ends with arming."""
    shared_network(scene)
    scene.hold("cam", 600.0)
    scene.armed = ArmedState.ARMED
    scene.agent.rest(3)
    assert scene.service.snapshot() == []
    with pytest.raises(HoldRefused, match="flight-critical"):
        scene.hold("cam")


def test_a_stop_that_takes_a_flight_critical_container_down_is_never_respected_quietly(scenes: Any) -> None:
    scene = scenes(on_manual_stop="respect")
    shared_network(scene)
    scene.armed = ArmedState.ARMED
    scene.agent.rest(1)
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.opened() == ["container/cam"], "the alarm")
    assert scene.changes() == []


@pytest.mark.parametrize("container", ["app", ALL])
def test_what_is_flight_critical_is_put_on_hold_when_the_armed_state_is_unknown(scene: Scene, container: str) -> None:
    """A bench has no autopilot, and a hold does nothing; the answer says what is not known, and arming ends the hold."""
    scene.armed = ArmedState.UNKNOWN
    said = scene.hold(container)
    assert said.endswith(
        "the vehicle is not known to be disarmed (as the test says): the hold ends when the autopilot is armed"
    )
    assert "not known" not in scene.hold("cam")
    scene.agent.rest(1)
    scene.armed = ArmedState.ARMED
    scene.agent.rest(3)
    assert [hold["container"] for hold in scene.service.snapshot()] == ["cam"]


def test_on_the_ground_a_hold_is_granted_without_a_warning(scene: Scene) -> None:
    """The autopilot is known to be disarmed."""
    assert "not known" not in scene.hold("app")


def test_take_off_ends_what_must_not_be_missed(scene: Scene) -> None:
    """Holds of flight-critical containers, with a message; an operator's hold of another one stays."""
    scene.hold("app", 600.0)
    scene.hold("cam", 600.0)
    scene.agent.rest(1)
    scene.armed = ArmedState.UNKNOWN
    scene.agent.rest(3)
    assert len(scene.service.snapshot()) == 2
    scene.armed = ArmedState.ARMED
    scene.agent.rest(3)
    assert [hold["container"] for hold in scene.service.snapshot()] == ["cam"]
    assert "the autopilot is armed" in scene.last()


# ---------------------------------------------------------------- stops by hand


def stopped(scene: Scene, key: str = "app") -> None:
    """`docker stop`, and what the checks see of it."""
    scene.happen(*STOP, key=key)
    scene.containers.end(key)
    scene.agent.bad = {f"container/{key}": "exited"}


def test_on_the_ground_a_stop_is_respected_for_a_while(scene: Scene) -> None:
    """No alarm, a hold with an end, and then a fault like any other."""
    stopped(scene)
    scene.agent.rest(10)
    assert scene.changes() == [("app", True)] and scene.agent.opened() == []
    assert scene.service.snapshot()[0]["source"] == "stop" and "stopped by hand" in scene.summary()
    scene.agent.rest(595)
    assert scene.agent.opened() == ["container/app"] and scene.agent.runs != []


def test_a_start_ends_the_hold_of_a_stop_and_no_other(scene: Scene) -> None:
    """What an operator put on hold stays so until its end."""
    scene.hold("cam", 600.0)
    stopped(scene)
    scene.agent.rest(10)
    scene.happen(("start", ""))
    scene.happen(("start", ""), key="cam")
    scene.agent.bad = {}
    scene.agent.rest(1)
    assert [hold["container"] for hold in scene.service.snapshot()] == ["cam"]
    assert "it was started again" in scene.last()


@pytest.mark.parametrize("by", ["start", "recreate"])
def test_what_was_started_without_an_event_is_not_on_hold(scenes: Any, by: str) -> None:
    """Before a stop is judged, the engine is asked whether the container is there; events are lost."""
    scene = scenes(on_manual_stop="respect")
    stopped(scene)
    getattr(scene.containers, by)("app")
    scene.agent.bad = {}
    scene.agent.rest(10)
    assert scene.changes() == [] and scene.level() is Level.OK


def test_a_copy_that_was_never_started_is_a_fault_when_the_old_one_is_removed(scenes: Any) -> None:
    """The name is there, under another id: nobody has removed the container by hand."""
    scene = scenes(on_manual_stop="respect")
    scene.containers.recreate("app")
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "created"}
    for action in ("kill", "die", "destroy"):
        scene.service.happened("app", action, "signal 9", "id of the old one")
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.changes() == []


def test_a_hold_ends_with_a_start_that_no_event_has_told(scene: Scene) -> None:
    """The containers are looked at every half minute."""
    stopped(scene)
    scene.agent.rest(10)
    scene.containers.start("app")
    scene.agent.bad = {}
    scene.agent.rest(60)
    assert scene.changes() == [("app", True), ("app", False)] and "it was started again" in scene.last()


@pytest.mark.parametrize("armed", [ArmedState.ARMED, ArmedState.UNKNOWN])
def test_in_the_air_a_stop_is_a_failure(scene: Scene, armed: ArmedState) -> None:
    """Also where nobody knows whether it is in the air."""
    scene.armed = armed
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.runs, "the restart")
    assert scene.agent.opened() == ["container/cam"] and scene.service.snapshot() == []


def test_one_word_is_the_rule_for_both(scenes: Any) -> None:
    """`on_manual_stop: respect`, e.g. for a bench without an autopilot."""
    scene = scenes(on_manual_stop="respect")
    scene.armed = ArmedState.UNKNOWN
    stopped(scene)
    scene.agent.rest(10)
    assert scene.changes() == [("app", True)] and scene.agent.opened() == []


def test_what_is_flight_critical_and_armed_is_never_respected_quietly(scenes: Any) -> None:
    """The alarm is raised even where the rule for the air is to respect."""
    scene = scenes(on_manual_stop="respect")
    scene.armed = ArmedState.ARMED
    stopped(scene)
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.changes() == []


def test_advise_raises_the_alarm_and_does_nothing_unless_approved(scenes: Any) -> None:
    """The advice says that it was stopped by hand."""
    scene = scenes(on_manual_stop="advise")
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.steps("cam") == [Phase.ADVISED], "the advice")
    assert "stopped by hand" in scene.agent.actions()[0].detail
    scene.agent.rest(5)
    assert scene.agent.runs == []
    scene.agent.executor.approve(scene.agent.pipeline.open_faults()[0].id)
    scene.agent.until(lambda: scene.agent.runs, "the restart")


@pytest.mark.parametrize("rule", ["respect", "advise"])
def test_a_stop_is_not_undone_because_a_fault_was_open_before(scenes: Any, rule: str) -> None:
    """Nothing is done before it is decided whether it was a stop by hand."""
    scene = scenes(on_manual_stop=rule)
    scene.agent.bad = {"container/app": "restarting"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the fault")
    stopped(scene)
    scene.agent.rest(20)
    assert scene.agent.runs == []


def test_a_crash_with_an_open_fault_is_healed_after_the_verdict(scenes: Any) -> None:
    """`docker kill` of a container that was failing already."""
    scene = scenes(on_manual_stop="respect")
    scene.agent.bad = {"container/app": "restarting"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the fault")
    scene.happen(("kill", "signal 9"), ("die", "exit code 137"))
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.until(lambda: scene.agent.runs, "the restart")


def test_a_stop_whose_signal_was_missed_is_not_undone(scenes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream was opened after the `kill`: the alarm comes with the `die`, and the action waits for a `stop`."""
    monkeypatch.setattr("phm.recovery.holds.manual_stop.UNSURE_S", 1.0)
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(True, scene.clock.mono(), scene.clock.mono())
    scene.agent.rest(1)
    scene.happen(STOP[1])
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.rest(0.5)
    assert scene.agent.opened() == ["container/app"]
    scene.happen(STOP[2])
    scene.agent.rest(30)
    assert scene.changes() == [("app", True)] and scene.agent.runs == []


def test_a_crash_after_the_stream_was_opened_is_healed(scenes: Any) -> None:
    """No `stop` follows; the alarm does not wait for one."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(True, scene.clock.mono(), scene.clock.mono())
    scene.agent.rest(1)
    scene.happen(STOP[1])
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.step()
    assert scene.agent.opened() == ["container/app"]
    scene.agent.until(lambda: scene.agent.runs, "the start")
    assert scene.changes() == []


def test_an_end_while_the_stream_is_closed_is_not_acted_on_before_it_is_explained(scenes: Any) -> None:
    """When it is open again, the engine replays what happened."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(False, scene.clock.mono(), 0.0)
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.rest(CLOSED_S / 2)
    scene.stream = EventStreamFact(True, scene.clock.mono(), 0.0)
    scene.happen(*STOP)
    scene.agent.rest(30)
    assert scene.changes() == [("app", True)] and scene.agent.runs == []


@pytest.mark.parametrize(("condition", "waits"), [("exited", True), ("broken", False)])
def test_a_stream_that_stays_closed_keeps_nothing_from_being_healed(scenes: Any, condition: str, waits: bool) -> None:
    """What has ended is acted on CLOSED_S after the stream broke, and what else is wrong is acted on immediately."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(False, scene.clock.mono(), 0.0)
    scene.agent.bad = {"container/app": condition}
    scene.agent.rest(CLOSED_S / 2)
    assert scene.agent.runs == ([] if waits else [("app", "container/app")])
    scene.agent.rest(CLOSED_S)
    assert scene.agent.runs[0] == ("app", "container/app")


def test_a_dependant_that_was_stopped_by_hand_is_not_started(scenes: Any) -> None:
    """Neither before that is decided nor afterwards, until somebody starts it."""
    scene = scenes(on_manual_stop="advise")
    holds = scene.holds
    assert holds.why_not_start("cam", scene.clock.stamp()) == ""
    stopped(scene, "cam")
    assert "being stopped" in holds.why_not_start("cam", scene.clock.stamp())
    scene.agent.rest(10)
    assert "stopped by hand" in holds.why_not_start("cam", scene.clock.stamp())
    scene.happen(("start", ""), key="cam")
    assert holds.why_not_start("cam", scene.clock.stamp()) == ""


def test_a_hold_binds_up_to_the_beginning_of_an_action(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the decision and the action the engine is asked, which takes seconds."""

    def asks(*_words: object) -> str:
        if not scene.service.snapshot():
            scene.hold(for_s=600)
        return ""

    monkeypatch.setattr(scene.agent.executor.catalog._actions["restart"], "waits_for", asks)
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.service.snapshot(), "the hold")
    scene.agent.rest(10)
    assert scene.agent.runs == [] and Phase.STARTED not in scene.agent.steps()


def test_while_a_recreation_may_be_under_way_nothing_is_raised(scenes: Any) -> None:
    """Whatever the rule is; a crash is not waited for."""
    scene = scenes(on_manual_stop="heal")
    scene.happen(("replace", ""), *STOP, ("destroy", ""))
    scene.agent.bad = {"container/app": "missing"}
    scene.agent.rest(10)
    scene.agent.bad = {}
    scene.happen(("start", ""))
    scene.agent.rest(5)
    assert scene.agent.opened() == []
    scene.agent.bad = {"container/app": "exited"}
    scene.happen(("die", "exit code 1"))
    scene.agent.rest(0.3)
    assert scene.agent.opened() == ["container/app"]


def test_what_else_is_wrong_meanwhile_is_raised(scenes: Any) -> None:
    """Only an end of the container may be part of a restart."""
    scene = scenes(on_manual_stop="heal")
    scene.happen(("kill", "signal 1"))
    scene.agent.bad = {"nodes/app": "broken"}
    scene.agent.until(lambda: scene.agent.opened() == ["nodes/app"], "the alarm")


# ---------------------------------------------------------------- maintenance windows


def test_a_window_holds_and_ends(scenes: Any) -> None:
    """FakeClock begins on 2023-11-14; the window is looked for once the clock was set."""
    scene = scenes(maintenance=[{"when": "02:00-02:10", "container": "cam", "reason": "upload"}])
    scene.clock.jump_utc(1795312740.0 - scene.clock.utc())  # 2026-11-22 01:59 UTC
    scene.agent.rest(50)
    assert scene.changes() == []
    scene.agent.rest(20)
    assert scene.changes() == [("cam", True)] and "maintenance window: upload" in scene.last()
    scene.agent.rest(600)
    assert scene.changes() == [("cam", True), ("cam", False)]


def test_a_window_that_was_released_or_set_back_does_not_open_again(scenes: Any) -> None:
    """An occurrence is one hold, whatever happens to the clock."""
    scene = scenes(maintenance=[{"when": "02:00-02:10"}])
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())  # 2026-11-22 02:01 UTC
    scene.agent.rest(10)
    assert scene.changes() == [("", True)]
    scene.service.release(ALL, BY)
    scene.clock.jump_utc(-30)
    scene.agent.rest(30)
    assert scene.changes() == [("", True), ("", False)]


def test_a_label_is_a_window_and_a_wrong_one_is_named_once(scene: Scene) -> None:
    """The label holds its own container."""
    scene.containers.facts["cam"] = replace(scene.containers.facts["cam"], maintenance="00:00-23:59")
    scene.containers.facts["app"] = replace(scene.containers.facts["app"], maintenance="whenever")
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())
    scene.agent.rest(70)
    assert scene.changes() == [("cam", True)]
    assert len([text for text in scene.agent.notes() if "'whenever' is not a maintenance window" in text]) == 1


@pytest.mark.parametrize(
    ("armed", "opens"), [(ArmedState.DISARMED, ["app", "cam"]), (ArmedState.UNKNOWN, ["cam"]), (ArmedState.ARMED, [])]
)
def test_no_window_opens_in_the_air(scenes: Any, armed: ArmedState, opens: list[str]) -> None:
    """For what is flight-critical only where the vehicle is known to be disarmed."""
    windows = [{"when": "00:00-23:59", "container": key} for key in ("app", "cam")]
    scene = scenes(maintenance=windows)
    scene.armed = armed
    scene.clock.jump_utc(1795312860.0 - scene.clock.utc())
    scene.agent.rest(10)
    assert sorted(hold["container"] for hold in scene.service.snapshot()) == opens


# ---------------------------------------------------------------- over a restart


def test_a_hold_survives_a_restart_of_phm(scenes: Any, tmp_path: Path) -> None:
    """With the same end."""
    first = scenes(tmp_path)
    first.hold(for_s=100)
    first.agent.rest(5)
    first.agent.stop()
    first.clock.advance(20)
    second = scenes(tmp_path, first.clock)
    hold = second.service.snapshot()[0]
    assert hold["reason"] == "new firmware" and 70 < hold["left_s"] < 76
    second.agent.bad = {"container/app": "broken"}
    second.agent.rest(60)
    assert second.agent.opened() == []
    second.agent.until(lambda: second.agent.opened() == ["container/app"], "the end of the hold")


def test_while_on_hold_no_check_is_run_for_the_sake_of_recovery(
    scenes: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault from before a restart of PHM: what is found on hold does not count, and a fresh run is asked for afterwards."""
    first = scenes(tmp_path, **PATIENT)
    first.agent.behave = lambda key, context, fault: None
    first.agent.bad = {"container/app": "broken"}
    first.agent.until(lambda: first.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    first.hold(for_s=100)
    first.agent.rest(5)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, bad={"container/app": "broken"}, **PATIENT)
    looks: list[str] = []
    monkeypatch.setattr(second.agent.pipeline, "recheck", lambda *units: looks.extend(units))
    second.agent.rest(60)
    assert looks == []
    second.agent.until(lambda: looks, "the fresh run")
    second.agent.until(lambda: Phase.STARTED in second.agent.steps(), "the next attempt")


def test_a_stop_that_is_over_when_phm_starts_holds_nothing(scenes: Any, tmp_path: Path) -> None:
    """It was started while PHM did not run, so no event says so; where it still is stopped, its hold goes on."""
    first = scenes(tmp_path)
    stopped(first, "app")
    stopped(first, "cam")
    first.agent.bad = {"container/app": "exited", "container/cam": "exited"}
    first.agent.rest(10)
    first.agent.stop()
    first.containers.start("app")
    second = scenes(tmp_path, first.clock, containers=first.containers)
    assert [hold["container"] for hold in second.service.snapshot()] == ["cam"]


def test_a_stop_that_is_only_advised_about_stays_so_over_a_restart(scenes: Any, tmp_path: Path) -> None:
    """Until the container is started."""
    first = scenes(tmp_path, on_manual_stop="advise")
    stopped(first, "cam")
    first.agent.until(lambda: first.agent.steps("cam") == [Phase.ADVISED], "the advice")
    first.agent.stop()
    first.containers.end("cam")
    second = scenes(tmp_path, first.clock, containers=first.containers, on_manual_stop="advise")
    second.agent.bad = {"container/cam": "exited"}
    second.agent.rest(20)
    assert second.agent.runs == []


def test_a_window_that_was_released_stays_so_over_a_restart(scenes: Any, tmp_path: Path) -> None:
    """An occurrence is one hold, also for the next PHM."""
    windows = [{"when": "02:00-02:10", "container": "cam"}]
    first = scenes(tmp_path, maintenance=windows)
    first.clock.jump_utc(1795312860.0 - first.clock.utc())  # 2026-11-22 02:01 UTC
    first.agent.rest(10)
    assert first.changes() == [("cam", True)]
    first.service.release("cam", BY)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, maintenance=windows)
    second.agent.rest(20)
    assert second.changes() == [] and second.service.snapshot() == []


def test_a_window_that_was_removed_from_the_configuration_ends(scenes: Any, tmp_path: Path) -> None:
    """The hold that was kept for it ends with it."""
    first = scenes(tmp_path, maintenance=[{"when": "02:00-02:10", "container": "cam"}])
    first.clock.jump_utc(1795312860.0 - first.clock.utc())  # 2026-11-22 02:01 UTC
    first.agent.rest(10)
    first.agent.stop()
    second = scenes(tmp_path, first.clock)
    second.agent.rest(20)
    assert second.changes() == [("cam", False)] and second.service.snapshot() == []


@pytest.mark.parametrize(("before", "left"), [(True, ["cam"]), (False, [])])
def test_only_a_take_off_ends_a_respected_stop(scene: Scene, before: bool, left: list[str]) -> None:
    """A stop that was respected in flight stays so when PHM is started again in flight; one from the ground does not."""
    known = RecoveryState(armed=LastArmedState(before, 0.0))
    scene.agent.executor.restore(PersistedState(recovery=known))
    scene.holds.put(Hold("cam", "stop", scene.clock.mono() + 600.0, "an operator"))
    scene.armed = ArmedState.ARMED
    world = HoldInputs(lambda: ArmedStatus(scene.armed, "armed"), lambda key: None, scene.agent.executor.action_on)
    following = HoldService(
        scene.agent.settings, scene.holds, scene.agent.pipeline, scene.agent.bus.publish, scene.clock, world
    )
    following.tick()
    assert [hold["container"] for hold in following.snapshot()] == left


def carried(left_s: float, *, boot: str, now: Stamp) -> Hold:
    """A hold of so many seconds at (utc 1000, mono 500) as it is read back at another moment."""
    holds = HoldRegistry()
    holds.put(Hold("app", "operator", 500.0 + left_s, BY, "why"))
    state = PersistedState(recovery=RecoveryState(holds=holds.kept(500.0)))
    document = json.loads(json.dumps(encode(state, "boot", Stamp(1000.0, 500.0))))
    return decode(document, boot, now, 600.0).recovery.holds[0].hold


@pytest.mark.parametrize("utc", [0.0, 1000.0, 1e9])
def test_on_the_same_boot_the_end_is_what_it_was(utc: float) -> None:
    """Whatever the clock of the day says."""
    assert carried(90.0, boot="boot", now=Stamp(utc, 530.0)).until == 590.0


@pytest.mark.parametrize("utc", [0.0, 1000.0, 1e9])
def test_after_a_reboot_what_was_left_counts(utc: float) -> None:
    """At most half a minute more, and never less because a clock was wrong."""
    assert carried(80.0, boot="other", now=Stamp(utc, 5.0)).until == 95.0


def test_what_is_left_is_written_every_half_minute() -> None:
    """So that reboots cannot extend a hold for ever, and a disk is not written to at each look."""
    holds = HoldRegistry()
    holds.put(Hold("app", "operator", 600.0, BY))
    assert holds.kept(0.0) == holds.kept(29.0) != holds.kept(31.0)


@pytest.mark.parametrize("body", [{"left_s": "x"}, {"left_s": 1e300}, {"until_mono": None}, {"target": 5}])
def test_a_damaged_hold_extends_nothing(body: dict[str, Any]) -> None:
    """It makes the file invalid, or lasts a day at most."""
    good = {
        "target": "app",
        "source": "operator",
        "until_mono": 600.0,
        "left_s": 60.0,
        "by": "",
        "reason": "",
        "occurrence": "",
    }
    document = encode(PersistedState(), "boot", Stamp(1000.0, 500.0))
    document["holds"] = [{**good, **body}]
    with contextlib.suppress(InvalidState):
        kept = decode(document, "other", Stamp(1000.0, 500.0), 600.0).recovery.holds
        assert all(entry.hold.until <= 500.0 + 86400.0 for entry in kept)


def test_a_signal_that_ends_nothing_is_no_stop(tmp_path: Path) -> None:
    """`docker kill -s HUP` has it read its configuration; SIGTERM may be the beginning of a stop."""
    made = settings(containers=[{"name": "app"}], state_dir=str(tmp_path / "state"), run_dir=str(tmp_path / "run"))
    daemon = Daemon(made)
    for number, end_s, undecided in (("1", 0.0, frozenset()), ("15", 121.0, frozenset({"app"}))):
        event = DockerEvent("container", "app", "kill", f"signal {number}", daemon.clock.stamp(), end_s=end_s)
        daemon.components.docker_events.apply(event)
        assert daemon.components.holds._stops.undecided() == undecided
    daemon.components.bus.close()
