"""PHM is off the network of a container while an action on that container is verified: joining takes half a second and comes first."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from phm.api import Result, error, stale
from phm.core.model import Evidence, Fault, Outcome, Phase
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {
    "container/app": Of("app"),
    "network/app": Of("app", ("container/app",), grace_s=3.0),
    "nodes/app": Of("app", ("container/app", "network/app"), grace_s=8.0),
}
UNSEEN = stale("not seen")
Start = Callable[..., Agent]


def dead() -> Result:
    """The engine no longer lists the process of the node."""
    found = error("process ended", brief="dead", condition="node_missing", target="app")
    return found.with_evidence(Evidence(certain=True, conclusive=True))


@pytest.fixture
def start() -> Iterator[Start]:
    made: list[Agent] = []

    def begin(*ladder: str) -> Agent:
        actions = (*dict.fromkeys((*ladder, "restart")), "join_network")
        ladders = {"node_missing": list(ladder)}
        made.append(Agent(UNITS, Containers("app"), FakeClock(), actions=actions, ladders=ladders))
        made[-1].rest(12.0)
        return made[-1]

    yield begin
    for agent in made:
        agent.stop()
        agent.clock.advance(1000)


def lose(agent: Agent, action: str, *, back: bool) -> None:
    """A node dies. While it is recovered, PHM loses the network and sees nothing of the node, until it joins again. back: whether the node
    is back then."""

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        agent.found.clear()
        if fault.unit == "network/app":
            agent.bad.clear()
            if not back:
                agent.found["nodes/app"] = dead()
            return
        if action == "restart":
            agent.containers.start(key)
            agent.pipeline.container_started(key)
        agent.bad["network/app"], agent.found["nodes/app"] = "sidecar_disconnected", UNSEEN

    agent.behave = act
    agent.found["nodes/app"] = dead()
    agent.until(lambda: Phase.DONE in agent.steps(), "the action on the container")


def begun(agent: Agent, action: str) -> list[float]:
    return [event.at.mono for event in agent.actions() if (event.phase, event.action) == (Phase.STARTED, action)]


@pytest.mark.parametrize("action", ["restart", "relaunch"])
def test_joining_does_not_wait_for_the_verification_of_an_action_on_the_container(start: Start, action: str) -> None:
    """Until PHM has joined, that could not succeed. The node is not blamed on the network, and the action gets the credit."""
    agent = start(action)
    lose(agent, action, back=True)
    agent.until(lambda: "network/app" in agent.opened(), "the alarm of the network")
    lost = agent.clock.mono()
    agent.rest(20.0)
    assert agent.acted() == [action, "join_network"]
    assert begun(agent, "join_network")[0] - lost <= 2.0
    assert Phase.FAILED not in agent.steps()
    closed = {event.fault.unit: (event.fault.outcome, event.fault.by) for event in agent.closed()}
    assert closed == {
        "nodes/app": (Outcome.RESOLVED, action),
        "network/app": (Outcome.RESOLVED, "join_network"),
    }


@pytest.mark.parametrize("action", ["restart", "relaunch"])
def test_a_node_that_is_not_back_then_gets_its_grace_before_the_next_action(start: Start, action: str) -> None:
    """The verification was interrupted, and the node may still be starting."""
    agent = start(action)
    lose(agent, action, back=False)
    agent.until(lambda: len(begun(agent, "join_network")) == 1, "joining")
    joined = agent.clock.mono()
    agent.until(lambda: len(agent.acted()) == 3, "the next action")
    assert begun(agent, action)[-1] - joined >= UNITS["nodes/app"].grace_s - 2.0


def test_a_restart_is_not_repeated_because_phm_cannot_join(start: Start) -> None:
    """PHM gives up on the network. The node stays unknown, with its fault open."""
    agent = start("restart")
    lose(agent, "restart", back=True)
    agent.behave = lambda *_: None
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    agent.rest(60.0)
    assert agent.acted() == ["restart", *["join_network"] * 3]
    assert [fault.unit for fault in agent.pipeline.open_faults()] == ["nodes/app"]
