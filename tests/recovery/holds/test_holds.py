"""The effect of a hold, which holds are granted, and which end when the vehicle is armed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from phm.core.model import FaultClosed, Level, Outcome, Phase
from phm.facts import CannotTell
from phm.recovery.executor import NotApprovable, NotNow
from phm.recovery.holds.hold_registry import ALL
from phm.recovery.holds.hold_service import LABELS_S, HoldRefused
from phm.recovery.safety.armed_state import ArmedState as ArmedState
from tests.recovery.holds.scene import BY, LONG_BACKOFF, Scene, stopped
from tests.recovery.simulated_agent import Containers


def test_a_bad_unit_on_hold_is_stale_without_an_alarm(scene: Scene) -> None:
    """With its end, operator and reason; no action is taken, and consequences are silent, too."""
    scene.hold()
    scene.agent.bad = {"container/app": "broken", "nodes/app": "broken"}
    scene.agent.rest(5)
    assert scene.level() is scene.level("nodes/app") is Level.STALE
    assert "on hold until" in scene.summary() and BY in scene.summary() and "new firmware" in scene.summary()
    assert scene.agent.opened() == [] and scene.agent.runs == []


def test_a_hung_engine_does_not_delay_the_end_of_a_hold() -> None:
    """It is asked for one container; for the next ones later."""
    names = [f"app{number}" for number in range(8)]
    scene = Scene(containers=Containers("app", "cam", *names))
    asked: list[str] = []

    def hang(key: str) -> None:
        asked.append(key)
        scene.clock.advance(5.0)
        raise CannotTell("the Docker Engine did not answer within 5 s")

    scene.service._world = replace(scene.service._world, container=hang)
    scene.hold(for_s=LABELS_S)
    for seen in 1, 2:
        scene.clock.advance(LABELS_S)
        began = scene.clock.mono()
        scene.service.tick()
        assert scene.clock.mono() - began <= 5.0 and len(set(asked)) == len(asked) == seen
        assert scene.service.snapshot() == []
    scene.stop()


def test_other_containers_are_not_affected(scene: Scene) -> None:
    """A hold applies to one container, or to all."""
    scene.hold("app")
    scene.agent.bad = {"container/cam": "broken"}
    scene.agent.until(lambda: ("cam", "container/cam") in scene.agent.runs, "the restart of cam")


def test_a_hold_without_a_container_applies_to_all(scene: Scene) -> None:
    """And `phm release` without one ends it."""
    scene.hold(ALL)
    scene.agent.bad = {"container/app": "broken", "container/cam": "broken"}
    scene.agent.rest(5)
    assert scene.agent.opened() == []
    scene.agent.bad = {}
    scene.service.release(ALL, BY)
    assert scene.service.snapshot() == []


def test_an_ok_unit_on_hold_is_ok(scene: Scene) -> None:
    """A hold does not hide OK."""
    scene.hold()
    scene.agent.rest(1)
    assert scene.level() is Level.OK


def test_a_hold_expires_with_a_message(scene: Scene) -> None:
    """Then a unit that is still bad is a fault and recovered."""
    scene.hold(for_s=10)
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.rest(9)
    assert scene.agent.opened() == []
    scene.agent.until(lambda: scene.agent.runs, "the restart")
    assert scene.changes() == [("app", True), ("app", False)] and "it has expired" in scene.last()
    assert scene.agent.opened() == ["container/app"]


def test_an_open_fault_stays_open_without_an_action(scenes: Any) -> None:
    """It is listed while on hold, its attempts stay unchanged, and it is recovered after a new result."""
    scene = scenes(**LONG_BACKOFF)
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
    """Without credit for an action."""
    scene = scenes(**LONG_BACKOFF)
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold()
    scene.agent.rest(1)
    scene.agent.bad = {}
    scene.agent.until(lambda: scene.agent.closed(), "the end of the fault")
    closed: FaultClosed = scene.agent.closed()[0]
    assert (closed.fault.outcome, closed.fault.by) == (Outcome.RESOLVED, "itself")


def test_no_action_follows_an_old_result_after_a_hold(scenes: Any) -> None:
    """The operator has fixed it at the last moment: no action follows."""
    scene = scenes(**LONG_BACKOFF)
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold(for_s=30)
    scene.agent.rest(29)
    scene.agent.bad = {}
    scene.agent.rest(30)
    assert len(scene.agent.runs) == 1


def test_a_running_action_is_finished_first(scene: Scene) -> None:
    """The answer to the operator names it."""
    answers: list[str] = []

    def slow(key: str, context: Any, fault: Any) -> None:
        answers.append(scene.hold())
        scene.containers.start(key)
        scene.agent.bad = {}

    scene.agent.behave = slow
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: Phase.VERIFIED in scene.agent.steps(), "the verification")
    assert "PHM first finishes the current action: restart of app" in answers[0]


def test_approvals_and_restarts_are_denied_on_hold(scene: Scene) -> None:
    """The answer states until when it is on hold."""
    scene.agent.behave = lambda key, context, fault: None
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.steps().count(Phase.FAILED) == 1, "a failed attempt")
    scene.hold()
    fault = scene.agent.pipeline.open_faults()[0].id
    with pytest.raises(NotApprovable, match="on hold until"):
        scene.agent.executor.approve(fault)
    with pytest.raises(NotNow, match="on hold until"):
        scene.agent.executor.restart("app", "the ground")


# ---------------------------------------------------------------- granted holds


@pytest.mark.parametrize(
    ("container", "for_s", "why"),
    [
        ("ap", 60.0, "no container 'ap'"),
        ("app", 0.5, "1 s to 14400 s"),
        ("app", 20000.0, "recovery.hold_max"),
        ("app", float("nan"), "recovery.hold_max"),
    ],
)
def test_an_invalid_hold_is_rejected(scene: Scene, container: str, for_s: float, why: str) -> None:
    """With the allowed values."""
    with pytest.raises(HoldRefused, match=why):
        scene.hold(container, for_s)


def test_a_second_hold_replaces_the_first(scene: Scene) -> None:
    """Also to shorten it."""
    scene.hold(for_s=600)
    scene.hold(for_s=10, reason="")
    assert [(hold["left_s"], hold["reason"]) for hold in scene.service.snapshot()] == [(10.0, "")]


def test_a_release_without_a_hold_is_rejected(scene: Scene) -> None:
    """And the message says when it is held by the hold on all."""
    with pytest.raises(HoldRefused, match=r"app is not on hold$"):
        scene.service.release("app", BY)
    scene.hold(ALL)
    with pytest.raises(HoldRefused, match="all containers are on hold"):
        scene.service.release("app", BY)


def test_setting_the_clock_changes_no_hold(scene: Scene) -> None:
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


# ---------------------------------------------------------------- in flight


@pytest.mark.parametrize("container", ["app", ALL])
def test_a_flight_critical_container_is_not_put_on_hold_while_armed(scene: Scene, container: str) -> None:
    """Its failures stay visible; another container may be put on hold."""
    scene.armed = ArmedState.ARMED
    with pytest.raises(HoldRefused, match="flight-critical"):
        scene.hold(container)
    scene.hold("cam")


def shared_network(scene: Scene, through: str = "") -> None:
    """app shares the network of cam, directly or through a container that is not configured."""
    if through:
        scene.others[through] = {"Id": "7" * 64, "Name": f"/{through}", "HostConfig": {"NetworkMode": "container:cam"}}
    mode = f"container:{through or 'cam'}"
    scene.containers.facts["app"] = replace(scene.containers.facts["app"], network_mode=mode)
    scene.agent.rest(2 * LABELS_S)


@pytest.mark.parametrize("through", ["", "unconfigured"])
def test_a_dependency_of_a_flight_critical_container_is_not_put_on_hold_while_armed(scene: Scene, through: str) -> None:
    """Its failure would take down the critical one and must stay visible as well; an earlier hold ends with arming."""
    shared_network(scene, through)
    scene.hold("cam", 600.0)
    scene.armed = ArmedState.ARMED
    scene.agent.rest(3)
    assert scene.service.snapshot() == []
    with pytest.raises(HoldRefused, match="flight-critical"):
        scene.hold("cam")


def test_a_stop_that_takes_a_flight_critical_container_down_always_raises_an_alarm(scenes: Any) -> None:
    """While armed, also with `on_manual_stop: respect`: no hold begins."""
    scene = scenes(on_manual_stop="respect")
    shared_network(scene)
    scene.armed = ArmedState.ARMED
    scene.agent.rest(1)
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.opened() == ["container/cam"], "the alarm")
    assert scene.changes() == []


@pytest.mark.parametrize("container", ["app", ALL])
def test_a_flight_critical_container_is_put_on_hold_when_the_armed_state_is_unknown(
    scene: Scene, container: str
) -> None:
    """A bench has no autopilot, and a hold takes no action; the answer states what is unknown, and arming ends the
    hold.
    """
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


def test_a_hold_is_granted_without_a_warning_while_disarmed(scene: Scene) -> None:
    """The autopilot is known to be disarmed."""
    assert "not known" not in scene.hold("app")


def test_arming_ends_holds_of_flight_critical_containers(scene: Scene) -> None:
    """Of flight-critical containers, with a message; an operator's hold of another one stays."""
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
