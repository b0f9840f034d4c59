"""Readiness in recovery: a restart is verified only when what was started is ready."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm import testing
from phm.checking.plan import build_plan
from phm.core.model import Fault, Outcome, Phase
from phm.recovery.base import ActionContext
from phm_checks.container import Container
from phm_checks.node_ready import NodeReady
from phm_checks.nodes import Nodes
from tests.recovery.simulated_agent import Agent, Containers, Of

CONTAINER, READY = "container/ros_app", "node_ready/a/planner"
CHECKS = {"container": Container, "nodes": Nodes, "node_ready": NodeReady}
SETTINGS = testing.settings(
    containers=[{"name": "ros_app"}],
    ros={"nodes": [{"name": "/a/planner", "ready": {"lifecycle": "active", "within": "20s"}}]},
)


@pytest.fixture
def agent() -> Iterator[Agent]:
    """An agent with the units of the real checks, whose container has just been found ended."""
    units = {
        entry.unit.id: Of(entry.unit.target, entry.needs, entry.unit.grace_s)
        for entry in build_plan(SETTINGS, CHECKS).tracked
    }
    made = Agent(units, Containers("ros_app"), testing.FakeClock(), opted_in=("ros_app",), actions=("start", "restart"))

    def start(key: str, context: ActionContext, fault: Fault) -> None:
        made.containers.start(key)
        made.bad.pop(CONTAINER, None)

    made.behave = start
    made.rest(30)
    made.containers.end("ros_app")
    made.bad = {CONTAINER: "exited", READY: "not_ready"}
    yield made
    made.stop()


def test_a_start_is_verified_when_its_node_is_ready(agent: Agent) -> None:
    """The container and its node run again after a moment, but the fault is resolved only when the node is active."""
    agent.until(lambda: Phase.DONE in agent.steps("ros_app"))
    agent.rest(10)
    assert Phase.VERIFIED not in agent.steps("ros_app") and not agent.closed()
    agent.bad.clear()
    agent.until(lambda: Phase.VERIFIED in agent.steps("ros_app"))
    assert agent.opened() == [CONTAINER]
    assert [event.fault.outcome for event in agent.closed()] == [Outcome.RESOLVED]


def test_a_start_after_which_its_node_is_never_ready_has_failed(agent: Agent) -> None:
    """After the start-up time of the node the next step follows."""
    agent.until(lambda: Phase.FAILED in agent.steps("ros_app"))
    agent.until(lambda: agent.acted() == ["start", "restart"])
    assert Phase.VERIFIED not in agent.steps("ros_app")
