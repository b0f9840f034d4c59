"""A container that is being stopped is not acted on before its stop timeout is over."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm import testing
from phm.core.model import Fault, Phase
from phm.facts import CannotTell
from phm.recovery.base import ActionContext
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {name: Of(name.partition("/")[2]) for name in ("health/app", "health/side")}


@pytest.fixture
def agent() -> Iterator[Agent]:
    made = Agent(
        UNITS, Containers("app", "side"), testing.FakeClock(), opted_in=("app", "side"), verify=5.0, backoff=0.1
    )
    yield made
    made.stop()
    made.clock.advance(1000)


def test_a_fault_of_a_container_that_is_being_stopped_waits(agent: Agent) -> None:
    """A restart would shorten its stop timeout, here a minute; once it has ended, or the time is over, it is acted on."""
    agent.pipeline.expect_stop("app", 60.0)
    agent.bad["health/app"] = "broken"
    agent.until(lambda: agent.opened() == ["health/app"], "the fault")
    agent.rest(30.0)
    assert agent.runs == []
    agent.pipeline.container_ended("app")
    agent.until(lambda: agent.runs == [("app", "health/app")], "the action")


def test_a_stop_that_does_not_happen_blocks_recovery_for_a_limited_time(agent: Agent) -> None:
    """The signal was caught, or the stop's SIGKILL event was lost."""
    agent.pipeline.expect_stop("app", 60.0)
    agent.bad["health/app"] = "broken"
    agent.rest(55.0)
    assert agent.runs == []
    agent.until(lambda: agent.runs, "the action")


def test_a_dependent_that_is_being_stopped_is_not_restarted(agent: Agent) -> None:
    """Not for another container either; that recovery continues without it."""
    refused: list[str] = []

    def act(key: str, context: ActionContext, fault: Fault) -> None:
        agent.containers.start(key)
        agent.bad.clear()
        try:
            with context.lock_dependent("side", fault, "restart", 30.0):
                agent.containers.start("side")
        except CannotTell as error:
            refused.append(str(error))

    agent.behave = act
    before = agent.containers.facts["side"]
    agent.pipeline.expect_stop("side", 1e6)  # the clock goes on while a slow machine starts the action
    agent.bad["health/app"] = "broken"
    agent.until(lambda: Phase.VERIFIED in agent.steps("app"), "the repair")
    assert refused == ["side is being stopped"]
    assert agent.containers.facts["side"] == before
