"""A container that ends, or is disconnected, while an action for another of its units is verified."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.api import error, stale
from phm.core.model import Evidence, Fault, Phase
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "health/app": Of("app", ("container/app",))}


@pytest.fixture
def agent() -> Iterator[Agent]:
    ladders = {"broken": ["restart"], "exited": ["start"]}
    made = Agent(UNITS, Containers("app"), FakeClock(), actions=("start", "restart"), ladders=ladders)

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        made.containers.start(key)
        made.pipeline.container_started(key)
        made.bad.clear()
        made.found = {"health/app": stale("starting")} if fault.unit == "health/app" else {}

    made.behave = act
    made.rest(3.0)
    yield made
    made.stop()
    made.clock.advance(1000)


@pytest.mark.parametrize("after_s", [0.5, 3.0, 10.0])
def test_a_container_that_exits_during_a_verification_is_started_soon(agent: Agent, after_s: float) -> None:
    """The verification would go on for 30 s: the health check of a container that does not run is unknown."""
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.DONE in agent.steps(), "the restart")
    agent.rest(after_s)
    agent.containers.end("app")
    agent.pipeline.container_ended("app")
    agent.bad["container/app"], agent.found["health/app"] = "exited", stale("not running")
    agent.rest(5.0)
    assert agent.opened() == ["health/app", "container/app"]
    assert agent.acted() == ["restart", "start"]
    failed = next(event for event in agent.actions() if event.phase is Phase.FAILED)
    assert failed.detail == "restart app did not recover container/app"


NETWORKED = {
    "container/app": Of("app"),
    "network/app": Of("app", ("container/app",), grace_s=3.0),
    "nodes/app": Of("app", ("container/app", "network/app"), grace_s=8.0),
}


def end_application(agent: Agent) -> None:
    """After some time without a fault; what needs the container is not known any more."""
    agent.rest(12.0)
    agent.containers.end("app")
    agent.pipeline.container_ended("app")
    agent.bad["container/app"] = "exited"
    agent.found |= {"network/app": stale("not running"), "nodes/app": stale("not running")}


def test_a_container_that_starts_without_its_network_is_reconnected_and_not_restarted() -> None:
    """It runs, so its start has worked; only the network explains that its nodes are lost."""
    ladders = {"exited": ["start", "restart"], "disconnected": ["reconnect", "restart"], "node_missing": ["restart"]}
    agent = Agent(NETWORKED, Containers("app"), FakeClock(), actions=("start", "restart", "reconnect"), ladders=ladders)
    detached = error("not on net", brief="not on net", condition="disconnected", target="app")

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        agent.bad.clear()
        agent.found.clear()
        if fault.unit == "container/app":
            agent.containers.start(key)
            agent.pipeline.container_started(key)
            agent.found["network/app"] = detached.with_evidence(Evidence(conclusive=True))
            agent.bad["nodes/app"] = "node_missing"

    agent.behave = act
    end_application(agent)
    agent.rest(10.0)
    assert agent.opened() == ["container/app", "network/app"]
    assert agent.acted() == ["start", "reconnect"]
    assert not agent.pipeline.open_faults()
    agent.stop()
    agent.clock.advance(1000)


def test_a_start_is_not_followed_by_a_restart_because_another_container_is_down() -> None:
    """A topic of the started container also needs the other one, on which PHM may not act: no restart brings the topic back."""
    units = {
        "container/a": Of("a"),
        "container/b": Of("b"),
        "nodes/a": Of("a", ("container/a",)),
        "topics/a": Of("a", ("nodes/a", "container/b")),
    }
    ladders = {"exited": ["start", "restart"]}
    agent = Agent(
        units, Containers("a", "b"), FakeClock(), opted_in=("a",), actions=("start", "restart"), ladders=ladders
    )

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        agent.containers.start(key)
        agent.pipeline.container_started(key)
        del agent.bad["container/a"], agent.found["nodes/a"]

    agent.behave = act
    agent.rest(3.0)
    agent.containers.end("b")
    agent.bad |= {"container/b": "exited", "topics/a": "subscriber_missing"}
    agent.rest(3.0)
    agent.containers.end("a")
    agent.bad["container/a"], agent.found["nodes/a"] = "exited", stale("not running")
    agent.rest(40.0)
    assert agent.acted() == ["start"]
    assert agent.opened() == ["container/b", "container/a"]
    assert [event.fault.unit for event in agent.closed()] == ["container/a"]
    agent.stop()
    agent.clock.advance(1000)


def test_a_container_that_starts_while_phm_is_off_its_network_is_not_restarted() -> None:
    """PHM was disconnected while the container was down. The start has worked, and PHM joins the network as soon as that is known."""
    ladders = {"exited": ["start", "restart"]}
    actions = ("start", "restart", "join_network")
    agent = Agent(NETWORKED, Containers("app"), FakeClock(), actions=actions, ladders=ladders)

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        agent.bad.clear()
        agent.found.clear()
        if fault.unit == "container/app":
            agent.containers.start(key)
            agent.pipeline.container_started(key)
            agent.bad["network/app"], agent.found["nodes/app"] = "sidecar_disconnected", stale("not seen")

    agent.behave = act
    end_application(agent)
    agent.rest(20.0)
    assert agent.opened() == ["container/app", "network/app"]
    assert agent.acted() == ["start", "join_network"]
    assert not agent.pipeline.open_faults()
    agent.stop()
    agent.clock.advance(1000)
