"""An action is not judged before its unit can be: a HEALTHCHECK in state `starting` has neither passed nor failed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from phm.api import Result, error, stale
from phm.core.model import Outcome, Phase
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "health/app": Of("app", ("container/app",)), "files/app": Of("app")}
LADDERS = {"unhealthy": ["restart"], "broken": ["restart"], "exited": ["restart"]}
DECIDES_S = 275.0
"""A HEALTHCHECK every 60 s with Docker's other defaults."""
UNHEALTHY = error("unhealthy", brief="unhealthy", condition="unhealthy", target="app")
STARTING = replace(stale("starting"), decides_s=DECIDES_S)
Start = Callable[[], Agent]


@pytest.fixture
def start() -> Iterator[Start]:
    made: list[Agent] = []

    def begin() -> Agent:
        made.append(Agent(UNITS, Containers("app"), FakeClock(), ladders=LADDERS, verify="30s", same_failure=3))
        made[-1].rest(3.0)
        return made[-1]

    yield begin
    for agent in made:
        agent.stop()


def restarted(agent: Agent, after: Result = STARTING) -> Agent:
    """The container is unhealthy; PHM restarts it, and then Docker reports `after`."""

    def behave(key: str, *_: object) -> None:
        agent.containers.start(key)
        agent.found["health/app"] = after

    agent.behave = behave
    agent.found["health/app"] = UNHEALTHY
    agent.until(lambda: agent.steps().count(Phase.DONE) == 1, "a restart")
    return agent


def test_a_container_with_a_slow_health_check_is_restarted_once(start: Start) -> None:
    """The first probe is a minute after the start, which is longer than `recovery.verify`."""
    agent = restarted(start())
    agent.rest(60.0)
    assert agent.steps() == [Phase.STARTED, Phase.DONE]
    del agent.found["health/app"]
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the verification")
    assert agent.steps() == [Phase.STARTED, Phase.DONE, Phase.VERIFIED]
    (closed,) = agent.closed()
    assert (closed.fault.outcome, closed.fault.by) == (Outcome.RESOLVED, "restart")


def test_the_next_attempt_follows_the_health_checks_result(start: Start) -> None:
    """Docker reports `unhealthy` again, long after the restart: only then has the restart failed."""
    agent = restarted(start())
    agent.rest(200.0)
    assert agent.acted() == ["restart"]
    agent.found["health/app"] = UNHEALTHY
    agent.until(lambda: len(agent.acted()) == 2, "the second attempt")
    assert agent.steps()[:4] == [Phase.STARTED, Phase.DONE, Phase.FAILED, Phase.STARTED]


def test_no_attempt_follows_without_a_new_error(start: Start) -> None:
    """Docker reports `starting` for longer than it may: the health is unknown, so there is no action and no giving up."""
    agent = restarted(start())
    agent.rest(DECIDES_S + 120.0)
    assert agent.acted() == ["restart"]
    assert Phase.FAILED not in agent.steps()
    agent.found["health/app"] = UNHEALTHY
    agent.until(lambda: len(agent.acted()) == 2, "the second attempt")


def test_an_unknown_health_for_another_reason_is_not_waited_for(start: Start) -> None:
    """The attempt fails after `recovery.verify`, and no other follows while the unit is not known to be in ERROR."""
    agent = restarted(start(), after=stale("the engine is slow"))
    agent.until(lambda: Phase.FAILED in agent.steps(), "the failure")
    agent.rest(60.0)
    assert agent.acted() == ["restart"]
    assert Phase.ESCALATED not in agent.steps()


def test_another_fault_of_the_container_does_not_wait(start: Start) -> None:
    """After `recovery.verify` other units of the container are reported and acted on, whatever the slow check waits
    for.
    """
    agent = restarted(start())
    agent.rest(40.0)
    agent.bad["files/app"] = "broken"
    agent.until(lambda: "files/app" in agent.opened(), "the alarm")
    agent.until(lambda: ("app", "files/app") in agent.runs, "its action")
    assert Phase.FAILED not in agent.steps()


def test_a_container_that_ends_while_it_is_starting_is_not_waited_for(start: Start) -> None:
    """Its health is no longer `starting`, but unknown."""
    agent = restarted(start())
    agent.rest(40.0)
    agent.bad["container/app"] = "exited"
    agent.found["health/app"] = stale("not known while it does not run")
    agent.until(lambda: ("app", "container/app") in agent.runs, "the action for the container")
