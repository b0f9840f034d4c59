"""A container's dependency has recovered: its back-off ends, and attempts that failed meanwhile are not counted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from phm import testing
from phm.api import Layer, Slot, Unit
from phm.checking.plan import CheckPlan
from phm.core.dependency_graph import DependencyGraph
from phm.core.model import Outcome, Phase
from phm.tracker import TrackedUnit
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"net/base": Of("base"), "health/app": Of("app", ("net/base",)), "files/app": Of("app")}
RULES: dict[str, Any] = {"verify": 5.0, "backoff": 50.0, "backoff_max": 60.0}


@pytest.fixture
def agents() -> Iterator[list[Agent]]:
    made: list[Agent] = []
    yield made
    for agent in made:
        agent.stop()
        agent.clock.advance(1000)


def make(agents: list[Agent], **recovery: Any) -> Agent:
    agent = Agent(UNITS, Containers("app", "base"), testing.FakeClock(), **{**RULES, **recovery})
    agents.append(agent)
    agent.rest(3.0)
    return agent


def failing(agent: Agent, unit: str = "health/app", attempts: int = 1) -> None:
    """The unit is bad, and `attempts` attempts on it have failed."""
    agent.bad[unit] = "broken"
    agent.until(lambda: agent.steps().count(Phase.FAILED) == attempts, f"{attempts} failed attempts")


def outage(agent: Agent, lasts_s: float = 2.0) -> None:
    """`base` is bad for a while, then OK; `app` stays bad."""
    agent.bad["net/base"] = "broken"
    agent.rest(lasts_s)
    assert agent.pipeline.open_faults()[0].unit == "net/base"
    del agent.bad["net/base"]


def test_back_off_ends_when_a_dependency_recovers(agents: list[Agent]) -> None:
    """`app` would wait for most of a minute; `base`, its dependency, recovers, and the next attempt is made
    immediately.
    """
    agent = make(agents)
    failing(agent)
    outage(agent)
    begun = agent.clock.mono()
    agent.until(lambda: len(agent.runs) == 2, "the next attempt")
    assert agent.clock.mono() - begun < 10.0


def test_back_off_continues_when_an_unrelated_unit_recovers(agents: list[Agent]) -> None:
    """`files/app` does not depend on `base`."""
    agent = make(agents)
    failing(agent, "files/app")
    agent.bad["net/base"] = "broken"
    agent.rest(2.0)
    del agent.bad["net/base"]
    agent.rest(30.0)
    assert len(agent.runs) == 1


def test_a_repair_of_the_container_itself_does_not_end_back_off(agents: list[Agent]) -> None:
    """Units of one container are recovered together: there the verification decides, not the recovery of another unit."""
    units = {"container/app": Of("app"), "health/app": Of("app", ("container/app",))}
    agent = Agent(units, Containers("app"), testing.FakeClock(), **RULES)
    agents.append(agent)
    agent.rest(3.0)
    failing(agent)
    agent.bad["container/app"] = "strange"  # no ladder: it fails and recovers without actions
    agent.rest(2.0)
    del agent.bad["container/app"]
    agent.rest(30.0)
    assert len(agent.runs) == 1


def test_attempts_made_while_a_dependency_was_down_are_not_counted(agents: list[Agent]) -> None:
    """Two attempts were made during an outage that was detected late: three more are made before PHM gives up."""
    agent = make(agents, backoff=4.0, verify=30.0)
    failing(agent, attempts=2)
    outage(agent)
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    assert len(agent.runs) == 2 + 3


def test_attempts_made_long_before_the_outage_count(agents: list[Agent]) -> None:
    """They failed while all dependencies were available; only the wait for the next attempt ends."""
    agent = make(agents, backoff=40.0, same_failure=2)
    failing(agent)
    agent.rest(10.0)
    outage(agent)
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    assert len(agent.runs) == 2


def test_a_flapping_dependency_costs_no_more_than_the_budget(agents: list[Agent]) -> None:
    """Each of its recoveries ends back-off and discounts attempts; the budget still counts them."""
    agent = make(agents, backoff=0.1, budget=4, reserve=0)
    agent.bad["health/app"] = "broken"
    for _ in range(20):
        agent.rest(5.0)
        outage(agent)
    agent.rest(20.0)
    assert len(agent.runs) == 4


def test_a_unit_given_up_during_the_outage_is_tried_again(agents: list[Agent]) -> None:
    """The cause is reported after PHM has given up on the consequence: all three attempts could not succeed."""
    agent = make(agents, backoff=0.1)
    failing(agent, attempts=3)
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    outage(agent)
    agent.bad["health/app"] = "broken"
    agent.behave = lambda key, context, fault: agent.bad.clear()
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the attempt that helps")
    assert len(agent.runs) == 4


def test_the_recovery_of_a_given_up_dependency_ends_back_off(agents: list[Agent]) -> None:
    """An operator has fixed `base`. Its fault was closed long ago: that it is OK again is what counts."""
    agent = make(agents)
    failing(agent)
    agent.bad["net/base"] = "broken"
    agent.rest(2.0)
    (fault,) = agent.pipeline.open_faults()
    agent.pipeline.escalate(fault.id)
    agent.rest(2.0)
    assert [event.fault.outcome for event in agent.closed()] == [Outcome.REATTRIBUTED, Outcome.ESCALATED]
    del agent.bad["net/base"]
    begun = agent.clock.mono()
    agent.until(lambda: len(agent.runs) == 2, "the next attempt")
    assert agent.clock.mono() - begun < 10.0


def test_dependents_of_a_unit_in_other_containers_are_found() -> None:
    """Transitively, by container; without its own container's units and those without a container."""
    units = {
        "a/one": ("one", ()),
        "b/one": ("one", ("a/one",)),
        "c/two": ("two", ("b/one",)),
        "d/two": ("two", ()),
        "e": ("", ("a/one",)),
        "f/three": ("three", ("e",)),
    }
    tracked = tuple(
        TrackedUnit(Unit(name, needs, target=target), name, Slot.CONTAINER, Layer.DOCKER, 1, needs)
        for name, (target, needs) in units.items()
    )
    plan = CheckPlan((), tracked, DependencyGraph({name: needs for name, (_, needs) in units.items()}))
    assert plan.below("a/one") == {"two": {"c/two"}, "three": {"f/three"}}
    assert plan.below("e") == {"three": {"f/three"}}
    assert plan.below("d/two") == plan.below("no such unit") == {}
