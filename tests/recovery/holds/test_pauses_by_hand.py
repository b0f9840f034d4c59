"""What PHM does after an operator has paused a container: the rules of a stop (`recovery.on_manual_stop`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Level, Phase
from phm.facts import EventStreamFact
from phm.recovery.holds.awaited_events import CLOSED_S, DIE_FOLLOWS_S
from phm.recovery.safety.armed_state import ArmedState as ArmedState
from tests.recovery.holds.scene import STOP, Scene

PAUSE, UNPAUSE = ("pause", ""), ("unpause", "")
PAUSED = {"container/app": "paused"}
LADDERS = {"paused": ["restart"], "exited": ["restart"]}


@pytest.fixture
def scene(scenes: Any) -> Scene:
    made: Scene = scenes(ladders=LADDERS)
    return made


def became(scene: Scene, key: str, status: str) -> None:
    scene.containers.facts[key] = replace(scene.containers.facts[key], status=status)


def paused(scene: Scene, key: str = "app") -> None:
    """`docker pause`, and the checks' results after it."""
    scene.happen(PAUSE, key=key)
    became(scene, key, "paused")
    scene.agent.bad = {f"container/{key}": "paused"}


def unpaused(scene: Scene) -> None:
    became(scene, "app", "running")
    scene.agent.bad = {}
    scene.happen(UNPAUSE)


def test_a_pause_is_respected_on_the_ground_until_the_unpause(scene: Scene) -> None:
    """`docker commit` pauses and unpauses; so does someone who looks at a process. No alarm, no action."""
    paused(scene)
    scene.agent.rest(40)
    assert scene.changes() == [("app", True)] and scene.agent.opened() == [] and scene.agent.runs == []
    assert scene.service.snapshot()[0]["source"] == "stop" and "paused by hand" in scene.summary()
    unpaused(scene)
    scene.agent.rest(1)
    assert scene.service.snapshot() == [] and "it was unpaused" in scene.last() and scene.level() is Level.OK
    scene.agent.bad = {"container/app": "broken"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm about something else")


def test_a_forgotten_pause_becomes_a_fault(scene: Scene) -> None:
    """After `recovery.hold`, as a stop."""
    paused(scene)
    scene.agent.rest(605)
    assert scene.agent.opened() == ["container/app"] and scene.agent.runs != []


@pytest.mark.parametrize("armed", [ArmedState.ARMED, ArmedState.UNKNOWN])
def test_a_pause_in_flight_is_a_failure(scene: Scene, armed: ArmedState) -> None:
    """Also where the armed state is unknown."""
    scene.armed = armed
    paused(scene, "cam")
    scene.agent.until(lambda: scene.agent.runs, "the action")
    assert scene.agent.opened() == ["container/cam"] and scene.service.snapshot() == []


def test_a_respected_pause_ends_when_the_vehicle_is_armed(scene: Scene) -> None:
    """It must be visible in flight."""
    paused(scene)
    scene.agent.rest(5)
    scene.armed = ArmedState.ARMED
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert "armed" in scene.last()


def test_a_pause_during_an_action_of_phm_is_not_by_hand(scene: Scene) -> None:
    """As with a stop: what happens while PHM acts on the container is taken for its doing."""
    scene.service._world = replace(scene.service._world, own=lambda key: True)
    paused(scene)
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.changes() == []


def test_a_pause_is_only_advised_with_the_rule_advise(scenes: Any) -> None:
    """The advice states that it was paused; a dependent that is paused is not restarted; an unpause ends both."""
    scene = scenes(on_manual_stop="advise", ladders=LADDERS)
    paused(scene, "cam")
    scene.agent.until(lambda: scene.agent.steps("cam") == [Phase.ADVISED], "the advice")
    assert "it was paused by hand" in scene.agent.actions()[0].detail and scene.agent.runs == []
    assert scene.holds.why_not_start("cam", scene.clock.stamp()) == "paused or stopped by hand"
    scene.happen(UNPAUSE, key="cam")
    assert scene.holds.why_not_start("cam", scene.clock.stamp()) == ""


def test_a_paused_container_that_is_stopped_is_stopped_by_hand(scene: Scene) -> None:
    """As recorded from Docker 20.10: it unpauses the container after the stop signal."""
    paused(scene)
    scene.agent.rest(1)
    scene.happen(STOP[0], UNPAUSE, ("kill", "signal 9"), *STOP[1:])
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.rest(10)
    assert scene.changes() == [("app", True), ("app", False), ("app", True)] and scene.agent.opened() == []
    assert "stopped by hand" in scene.summary()


def test_a_paused_container_that_is_killed_has_crashed(scene: Scene) -> None:
    """`docker kill`, or the kernel for lack of memory: no `unpause` comes before the `die`."""
    paused(scene)
    scene.agent.rest(1)
    scene.happen(("kill", "signal 9"), ("die", "exit code 137"))
    scene.containers.end("app")
    scene.agent.bad = {"container/app": "exited"}
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    assert scene.service.snapshot() == []


def test_a_pause_found_before_its_event_waits_for_it(scene: Scene) -> None:
    """A periodic check may be earlier than the event. Without one, the container is unpaused all the same."""
    scene.agent.bad = PAUSED
    scene.agent.rest(DIE_FOLLOWS_S / 2)
    assert scene.agent.opened() == ["container/app"] and scene.agent.runs == []
    scene.agent.rest(2 * DIE_FOLLOWS_S)
    assert scene.agent.runs != []


def test_a_pause_in_flight_waits_for_no_event(scene: Scene) -> None:
    """It has arrived."""
    scene.armed = ArmedState.ARMED
    paused(scene, "cam")
    assert scene.holds.undecided("cam", scene.clock.mono(), ended=True, paused=True) is None


def test_a_pause_while_the_event_stream_is_closed_is_respected(scene: Scene) -> None:
    """When it is open again, the engine replays the events."""
    scene.stream = EventStreamFact(False, scene.clock.mono(), 0.0)
    became(scene, "app", "paused")
    scene.agent.bad = PAUSED
    scene.agent.rest(CLOSED_S / 2)
    scene.stream = EventStreamFact(True, scene.clock.mono(), 0.0)
    scene.happen(PAUSE)
    scene.agent.rest(30)
    assert scene.changes() == [("app", True)] and scene.agent.runs == []


def test_a_respected_pause_outlives_a_restart_of_phm(scenes: Any, tmp_path: Path) -> None:
    """With the rest of its time; a container that is paused does not run."""
    first = scenes(tmp_path, ladders=LADDERS)
    paused(first)
    first.agent.rest(5)
    first.agent.stop()
    second = scenes(tmp_path, first.clock, containers=first.containers, bad=PAUSED, ladders=LADDERS)
    second.agent.rest(5)
    assert second.agent.runs == [] and "paused by hand" in second.summary()
    unpaused(second)
    assert second.service.snapshot() == []
