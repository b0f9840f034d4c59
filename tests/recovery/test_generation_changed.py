"""A fault is acted on in the container's life in which it was found; in a later one it must be found again."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm import testing
from phm.api import ok
from phm.core.model import Event, Evidence, FaultOpened, Phase
from tests.fakes.until import until
from tests.recovery.simulated_agent import Agent, Containers, Of

CONTAINER, ONE, TWO = "container/app", "nodes/app", "more/app"
UNITS = {
    CONTAINER: Of("app"),
    ONE: Of("app", (CONTAINER,), grace_s=4.0),
    TWO: Of("app", (CONTAINER,), grace_s=4.0),
}


@pytest.fixture
def agent() -> Iterator[Agent]:
    made = Agent(UNITS, Containers("app"), testing.FakeClock(), verify=10.0, backoff=0.1)
    made.behave = lambda key, context, fault: restart(made)
    seen(made)
    made.rest(5.0)
    yield made
    made.stop()
    made.clock.advance(1000)


def seen(agent: Agent) -> None:
    """The container's check reports the life that it sees."""
    agent.found[CONTAINER] = ok("running").with_evidence(Evidence(generation=agent.containers.facts["app"].generation))


def restart(agent: Agent) -> None:
    agent.containers.start("app")
    seen(agent)


def test_an_external_restart_between_fault_and_action_replaces_the_action(agent: Agent) -> None:
    """Recovery had to wait, and the container was restarted meanwhile: a unit that returns in time causes no second
    restart.
    """
    agent.missing = "a network"
    agent.bad[ONE] = "broken"
    agent.until(lambda: Phase.REFUSED in agent.steps(), "the wait")
    restart(agent)
    agent.missing = ""
    agent.rest(3.0)
    del agent.bad[ONE]
    agent.rest(10.0)
    assert agent.runs == []
    assert [event.fault.by for event in agent.closed()] == ["itself"]


def test_a_unit_missing_in_the_new_life_is_acted_on_after_its_grace(agent: Agent) -> None:
    """An external restart that did not help does not prevent the next one."""
    agent.missing = "a network"
    agent.bad[ONE] = "broken"
    agent.until(lambda: Phase.REFUSED in agent.steps(), "the wait")
    restart(agent)
    agent.missing = ""
    agent.rest(3.0)
    assert agent.runs == []
    agent.until(lambda: agent.runs == [("app", ONE)], "the action")


def test_a_second_fault_of_the_earlier_life_causes_no_restart(agent: Agent) -> None:
    """Recovery gets it only when the restart for the first one is over, as on a machine on which its thread is late."""
    late: list[Event] = []
    subscription = next(one for one in agent.bus._subscriptions if one.name == "recovery")

    def handle(event: Event) -> None:
        if isinstance(event, FaultOpened) and event.fault.unit == TWO:
            late.append(event)
        else:
            agent.executor.handle(event)

    subscription._handler = handle
    agent.bad[ONE] = agent.bad[TWO] = "broken"
    agent.until(lambda: agent.runs, "the restart")
    del agent.bad[ONE]
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "its verification")
    assert sorted(agent.opened()) == [TWO, ONE]
    agent.executor.handle(late[0])
    agent.rest(2.0)
    del agent.bad[TWO]
    agent.rest(10.0)
    assert agent.runs == [("app", ONE)]


def test_a_fault_of_the_current_life_is_acted_on_immediately(agent: Agent) -> None:
    """Also one that opens after several restarts: no time has to pass on PHM's clock."""
    for _ in range(3):
        restart(agent)
        agent.rest(5.0)
    agent.bad[ONE] = "broken"
    agent.until(lambda: agent.opened() == [ONE], "the fault")
    until(lambda: agent.runs, "the action")
    assert agent.runs == [("app", ONE)]
