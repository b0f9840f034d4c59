"""Recovery of a container that was created: not before its creator had time to start it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from phm import testing
from phm.api import Result, stale
from phm.core.model import FaultOpened
from phm.recovery.worker import MISSING_S, NOT_STARTED_S
from phm.testing import FakeClock
from phm_checks.container import UNSTARTED_S, Container
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "nodes/app": Of("app", ("container/app",))}
SOON_S = 3.0
UNKNOWN = stale("the Docker Engine did not respond within 2 s")


class Scene:
    """PHM with the real container check, on a fake clock. `facts`: the containers as the engine reports them."""

    def __init__(self) -> None:
        self.agent = Agent(UNITS, Containers("app"), FakeClock(), actions=("start", "restart"))
        self.facts = self.agent.containers.facts
        self.unknown = False
        (self._check,) = Container.build(testing.settings(containers=[{"name": "app"}]))
        observe = self.agent.observe
        self.agent.observe = lambda: (self._look(), observe())[1]  # type: ignore[method-assign]
        self.rechecked: list[str] = []
        self.agent.pipeline.attach(lambda units, reason: self.rechecked.extend(units))
        self.agent.rest(SOON_S)

    def _look(self) -> None:
        if self.unknown:
            self.agent.found["container/app"] = UNKNOWN
            return
        docker = testing.FakeDocker(*self.facts.values())
        found = self._check.run(testing.world(clock=self.agent.clock, docker=docker))
        assert isinstance(found, Result)
        self.agent.found["container/app"] = found

    def became(self, **fields: Any) -> None:
        self.facts["app"] = testing.container("app", **fields)

    def found_as(self) -> list[str]:
        """The conditions with which faults were opened."""
        return [event.fault.result.condition for event in self.agent.of(FaultOpened)]

    def opened_at(self) -> float:
        opened: FaultOpened = self.agent.of(FaultOpened)[0]
        return opened.fault.opened.mono


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    yield made
    made.agent.stop()


def test_a_container_that_compose_makes_is_not_started_by_phm(scene: Scene) -> None:
    """It waits for the health of what it depends on; nothing is reported, not even the nodes that it does not have."""
    scene.became(status="created", id="new")
    scene.agent.bad = {"nodes/app": "broken"}
    scene.agent.rest(UNSTARTED_S - SOON_S)
    assert scene.agent.opened() == [] and scene.agent.runs == []
    scene.became(id="new")
    scene.agent.bad = {}
    scene.agent.rest(SOON_S)
    assert scene.agent.opened() == [] and scene.agent.runs == []


def test_a_container_that_stays_unstarted_is_a_fault_and_is_started(scene: Scene) -> None:
    """`docker compose create`, or an update that was not finished."""
    scene.became(status="created", id="new")
    scene.agent.rest(UNSTARTED_S - SOON_S)
    assert scene.agent.opened() == []
    scene.agent.until(lambda: scene.agent.acted() == ["start"], "the start")
    assert scene.agent.opened() == ["container/app"] and scene.found_as() == ["created"]


def test_a_start_that_failed_is_repeated_immediately(scene: Scene) -> None:
    """The engine's error shows that someone has tried."""
    begun = scene.agent.clock.mono()
    scene.became(status="created", id="new", error="no such file")
    scene.agent.until(lambda: scene.agent.acted() == ["start"], "the start")
    assert scene.found_as() == ["created"] and scene.opened_at() - begun < SOON_S


def test_the_minute_counts_also_where_its_absence_was_a_fault(scene: Scene) -> None:
    """`docker compose down` and later `up`: the fault that it is missing is open, and no reason to start it early."""
    del scene.facts["app"]
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    scene.became(status="created", id="new")
    scene.agent.rest(UNSTARTED_S - SOON_S)
    assert scene.agent.runs == []
    scene.agent.until(lambda: scene.agent.acted() == ["start"], "the start")
    assert scene.found_as() == ["missing"] and scene.agent.opened() == ["container/app"]


def test_its_check_runs_often_enough_that_the_start_comes_when_the_minute_is_over(scene: Scene) -> None:
    """Its period is 5 s, and with a fault open already nothing waits for confirmation: in a campaign the start came after 65 s."""
    del scene.facts["app"]
    scene.agent.until(lambda: scene.agent.opened() == ["container/app"], "the alarm")
    scene.became(status="created", id="new")
    scene.agent.rest(SOON_S)
    scene.rechecked.clear()
    scene.agent.rest(5 * MISSING_S)
    assert scene.rechecked.count("container/app") in (4, 5)
    scene.became(id="new")
    scene.agent.rest(SOON_S)
    scene.rechecked.clear()
    scene.agent.rest(5 * MISSING_S)
    assert "container/app" not in scene.rechecked


def broken_before(scene: Scene) -> None:
    """A node was broken before its container was replaced by one that is not started yet."""
    scene.agent.missing = "the engine does not answer"
    scene.agent.bad = {"nodes/app": "broken"}
    scene.agent.rest(15.0)
    assert scene.agent.opened() == ["nodes/app"] and scene.agent.runs == []
    scene.became(status="created", id="new")
    scene.agent.missing = ""


def test_another_fault_of_the_container_does_not_start_it_either(scene: Scene) -> None:
    broken_before(scene)
    scene.agent.rest(UNSTARTED_S - SOON_S)
    assert scene.agent.runs == []


@pytest.mark.parametrize("open_before", [True, False])
def test_a_run_without_an_answer_does_not_start_it(scene: Scene, *, open_before: bool) -> None:
    """The engine did not answer one request, or the check took too long: whether it has been started is unknown for some seconds."""
    if open_before:
        broken_before(scene)
    scene.became(status="created", id="new")
    scene.agent.bad = {"nodes/app": "broken"}
    scene.agent.rest(SOON_S)
    scene.unknown = True
    scene.agent.rest(SOON_S)
    scene.unknown = False
    scene.agent.rest(SOON_S)
    assert scene.agent.runs == []
    scene.became(id="new")
    scene.agent.until(lambda: scene.agent.runs, "the action on the node, which is broken in the new container, too")


def test_a_container_whose_state_stays_unknown_is_not_waited_for_longer(scene: Scene) -> None:
    """Its creator has had its time."""
    broken_before(scene)
    scene.agent.rest(SOON_S)
    scene.unknown = True
    scene.agent.rest(NOT_STARTED_S - SOON_S)
    assert scene.agent.runs == []
    scene.agent.until(lambda: scene.agent.runs, "the action on the node")
