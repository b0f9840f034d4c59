"""What PHM does after an operator has stopped a container (`recovery.on_manual_stop`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Fault, Level, Phase
from phm.facts import EventStreamFact
from phm.recovery.base import ActionContext
from phm.recovery.holds.awaited_events import CLOSED_S, DIE_FOLLOWS_S
from phm.recovery.holds.hold_service import LABELS_S
from phm.recovery.safety.armed_state import ArmedState as ArmedState
from tests.recovery.holds.scene import STOP, Scene, stopped
from tests.recovery.simulated_agent import Containers


def test_a_stop_is_respected_for_a_while_on_the_ground(scene: Scene) -> None:
    """No alarm, a hold with an end, and then a fault like any other."""
    stopped(scene)
    scene.agent.rest(10)
    assert scene.changes() == [("app", True)] and scene.agent.opened() == []
    assert scene.service.snapshot()[0]["source"] == "stop" and "stopped by hand" in scene.summary()
    scene.agent.rest(595)
    assert scene.agent.opened() == ["container/app"] and scene.agent.runs != []


@pytest.mark.parametrize(("events", "wait_s"), [(STOP, 3.0), ((*STOP, ("destroy", "")), 15.0)])
def test_a_reload_must_wait_until_a_stop_is_decided(
    scenes: Any, tmp_path: Path, events: tuple[tuple[str, str], ...], wait_s: float
) -> None:
    """The next PHM would not know of the stop and would start the container; once it is decided, the hold is kept."""
    first = scenes(tmp_path)
    assert first.service.undecided() == {}
    first.happen(*events)
    first.containers.end("app")
    first.agent.bad = {"container/app": "exited"}
    first.agent.rest(1.0)
    assert first.service.undecided() == {"app": pytest.approx(wait_s - 1.0)}
    first.agent.rest(wait_s)
    assert first.service.undecided() == {}
    first.agent.stop()
    second = scenes(tmp_path, first.clock, containers=first.containers, bad=first.agent.bad)
    second.agent.rest(30)
    assert (second.agent.opened(), second.agent.runs) == ([], [])


def test_a_start_ends_only_the_hold_of_a_stop(scene: Scene) -> None:
    """An operator's own hold stays until its end."""
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
def test_a_container_started_without_an_event_is_not_on_hold(scenes: Any, by: str) -> None:
    """Before a stop is judged, the engine is asked whether the container exists, because events can be lost."""
    scene = scenes(on_manual_stop="respect")
    stopped(scene)
    getattr(scene.containers, by)("app")
    scene.agent.bad = {}
    scene.agent.rest(10)
    assert scene.changes() == [] and scene.level() is Level.OK


def test_a_replacement_that_was_never_started_is_a_fault(scenes: Any) -> None:
    """The name exists, with another id: the container was not removed manually."""
    scene = scenes(on_manual_stop="respect")
    scene.containers.recreate("app")
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "created"}
    for action in ("kill", "die", "destroy"):
        scene.service.happened("app", action, "signal 9", "id of the old one")
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.changes() == []


def test_a_hold_ends_with_a_start_whose_event_was_lost(scene: Scene) -> None:
    """The containers are checked every half minute."""
    stopped(scene)
    scene.agent.rest(10)
    scene.containers.start("app")
    scene.agent.bad = {}
    scene.agent.rest(60)
    assert scene.changes() == [("app", True), ("app", False)] and "it was started again" in scene.last()


@pytest.mark.parametrize("armed", [ArmedState.ARMED, ArmedState.UNKNOWN])
def test_a_stop_in_flight_is_a_failure(scene: Scene, armed: ArmedState) -> None:
    """Also where the armed state is unknown."""
    scene.armed = armed
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.runs, "the restart")
    assert scene.agent.opened() == ["container/cam"] and scene.service.snapshot() == []


def test_a_single_rule_applies_on_the_ground_and_in_flight(scenes: Any) -> None:
    """`on_manual_stop: respect`, e.g. for a bench without an autopilot."""
    scene = scenes(on_manual_stop="respect")
    scene.armed = ArmedState.UNKNOWN
    stopped(scene)
    scene.agent.rest(10)
    assert scene.changes() == [("app", True)] and scene.agent.opened() == []


def test_a_stop_of_an_armed_flight_critical_container_always_raises_an_alarm(scenes: Any) -> None:
    """The alarm is raised even if the rule for flight is to respect stops."""
    scene = scenes(on_manual_stop="respect")
    scene.armed = ArmedState.ARMED
    stopped(scene)
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.changes() == []


def test_advise_raises_the_alarm_and_does_nothing_unless_approved(scenes: Any) -> None:
    """The advice states that it was stopped manually."""
    scene = scenes(on_manual_stop="advise")
    stopped(scene, "cam")
    scene.agent.until(lambda: scene.agent.steps("cam") == [Phase.ADVISED], "the advice")
    assert "stopped by hand" in scene.agent.actions()[0].detail
    scene.agent.rest(5)
    assert scene.agent.runs == []
    scene.agent.executor.approve(scene.agent.pipeline.open_faults()[0].id)
    scene.agent.until(lambda: scene.agent.runs, "the restart")


@pytest.mark.parametrize("rule", ["respect", "advise"])
def test_a_stop_is_not_undone_because_of_an_open_fault(scenes: Any, rule: str) -> None:
    """No action is taken before it is decided whether it was a manual stop."""
    scene = scenes(on_manual_stop=rule)
    scene.agent.bad = {"container/app": "restarting"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the fault")
    stopped(scene)
    scene.agent.rest(20)
    assert scene.agent.runs == []


def test_a_crash_with_an_open_fault_is_recovered_after_the_decision(scenes: Any) -> None:
    """`docker kill` of a container that had already failed."""
    scene = scenes(on_manual_stop="respect")
    scene.agent.bad = {"container/app": "restarting"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the fault")
    scene.happen(("kill", "signal 9"), ("die", "exit code 137"))
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.until(lambda: scene.agent.runs, "the restart")


def test_a_stop_with_a_missed_signal_is_not_undone(scenes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The stream was opened after the `kill`: the alarm is raised with the `die`, and the action waits for a `stop`."""
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


@pytest.mark.parametrize("condition", ["exited", "ended", "oom"])
def test_an_end_that_may_be_part_of_a_recreation_is_not_reported(scenes: Any, condition: str) -> None:
    """Also if only its cgroup shows it, because the engine is too busy with the recreation to answer PHM."""
    scene = scenes()
    scene.happen(("replace", ""), *STOP[:2])
    scene.agent.bad = {"container/app": condition}
    scene.agent.rest(5.0)
    assert scene.agent.opened() == []


@pytest.mark.parametrize("stops", [True, False])
def test_an_exit_found_before_its_event_waits_for_it(scenes: Any, stops: bool) -> None:
    """A periodic check may be earlier than the `die`. Without one, the container is started all the same."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(True, scene.clock.mono(), scene.clock.mono())
    scene.agent.rest(1)
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.rest(DIE_FOLLOWS_S / 2)
    assert scene.agent.opened() == ["container/app"] and scene.agent.runs == []
    scene.happen(*(STOP[1:] if stops else ()))
    scene.agent.rest(30)
    assert bool(scene.agent.runs) is not stops
    assert scene.changes() == ([("app", True)] if stops else [])


def test_a_container_that_had_exited_before_phm_looked_is_not_waited_for(scenes: Any) -> None:
    """Its `die` was before the stream."""
    containers = Containers("app", "cam")
    containers.end("app")
    scene = scenes(containers=containers, bad={"container/app": "exited"}, on_manual_stop="respect")
    scene.stream = EventStreamFact(True, scene.clock.mono(), scene.clock.mono())
    assert scene.holds.undecided("app", scene.clock.mono() + 1.0, ended=True) is None
    assert scene.holds.undecided("cam", scene.clock.mono() + 1.0, ended=True) is not None


def test_an_exit_is_waited_for_again_once_the_container_was_seen_running(scenes: Any) -> None:
    """It had exited before PHM looked, and the event of its start was lost."""
    containers = Containers("app", "cam")
    containers.end("app")
    scene = scenes(containers=containers, on_manual_stop="respect")
    containers.start("app")
    scene.agent.rest(LABELS_S + 1)
    scene.stream = EventStreamFact(True, scene.clock.mono(), scene.clock.mono())
    assert scene.holds.undecided("app", scene.clock.mono() + 1.0, ended=True) is not None


def test_no_event_is_waited_for_while_the_stream_is_closed_for_long(scenes: Any) -> None:
    """Where the engine's events are not permitted, the stream never opens."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(False, scene.clock.mono() - 2 * CLOSED_S)
    assert scene.holds.undecided("app", scene.clock.mono(), ended=True) is None


def test_a_crash_after_the_stream_was_opened_is_recovered(scenes: Any) -> None:
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


def test_an_end_during_a_stream_outage_is_not_acted_on_before_its_events_arrive(scenes: Any) -> None:
    """When it is open again, the engine replays the events."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(False, scene.clock.mono(), 0.0)
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.rest(CLOSED_S / 2)
    scene.stream = EventStreamFact(True, scene.clock.mono(), 0.0)
    scene.happen(*STOP)
    scene.agent.rest(30)
    assert scene.changes() == [("app", True)] and scene.agent.runs == []


@pytest.mark.parametrize(("condition", "waits"), [("exited", True), ("oom", True), ("broken", False)])
def test_a_lasting_stream_outage_does_not_prevent_recovery(scenes: Any, condition: str, waits: bool) -> None:
    """A container that has ended is acted on CLOSED_S after the stream broke; other faults are acted on immediately."""
    scene = scenes(on_manual_stop="respect")
    scene.stream = EventStreamFact(False, scene.clock.mono(), 0.0)
    scene.agent.bad = {"container/app": condition}
    scene.agent.rest(CLOSED_S / 2)
    assert scene.agent.runs == ([] if waits else [("app", "container/app")])
    scene.agent.rest(CLOSED_S)
    assert scene.agent.runs[0] == ("app", "container/app")


def test_a_manually_stopped_dependent_is_not_started(scenes: Any) -> None:
    """Neither before that is decided nor afterwards, until it is started manually."""
    scene = scenes(on_manual_stop="advise")
    holds = scene.holds
    assert holds.why_not_start("cam", scene.clock.stamp()) == ""
    stopped(scene, "cam")
    assert "being stopped" in holds.why_not_start("cam", scene.clock.stamp())
    scene.agent.rest(10)
    assert "stopped by hand" in holds.why_not_start("cam", scene.clock.stamp())
    scene.happen(("start", ""), key="cam")
    assert holds.why_not_start("cam", scene.clock.stamp()) == ""


def test_a_stop_during_the_restart_of_a_dependent_is_respected(scene: Scene) -> None:
    """PHM has restarted `app`, and now restarts `cam` because of it. It started `app` again each time it was stopped."""
    agent = scene.agent

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        context.engine.restart(key)
        scene.containers.start(key)
        agent.bad = {}
        with context.lock_dependent("cam", fault, "restart", 30.0):
            started_at = agent.clock.mono()
            agent.pause(lambda: agent.clock.mono() - started_at > 2.0)
            stopped(scene)
            scene.containers.start("cam")

    agent.behave = act
    agent.bad = {"container/app": "broken"}
    agent.until(lambda: agent.runs, "the restart")
    agent.rest(60)
    assert scene.changes() == [("app", True)] and len(agent.runs) == 1


def test_a_hold_prevents_an_action_that_has_not_begun(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the decision and the action the engine is queried, which takes seconds."""

    def asks(*_words: object) -> str:
        if not scene.service.snapshot():
            scene.hold(for_s=600)
        return ""

    monkeypatch.setattr(scene.agent.executor.catalog._actions["restart"], "waits_for", asks)
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.service.snapshot(), "the hold")
    scene.agent.rest(10)
    assert scene.agent.runs == [] and Phase.STARTED not in scene.agent.steps()


def test_no_alarm_is_raised_during_a_possible_recreation(scenes: Any) -> None:
    """Whatever the rule is; a crash raises one immediately."""
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


def test_other_faults_are_raised_meanwhile(scenes: Any) -> None:
    """Only an end of the container may be part of a restart."""
    scene = scenes(on_manual_stop="heal")
    scene.happen(("kill", "signal 1"))
    scene.agent.bad = {"nodes/app": "broken"}
    scene.agent.until(lambda: scene.agent.opened() == ["nodes/app"], "the alarm")
