"""Recovery decides on the present failure: ladder, target and refusals follow a fault whose condition changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from phm.api import Result, error, stale, warn
from phm.core.model import Fault, Level, Outcome, Phase
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "network/app": Of("app", ("container/app",)), "nodes/one": Of("app")}
HUNG = error("hung", brief="hung", condition="node_hung", target="app")
UNREACHABLE = error("unreachable", brief="unreachable", condition="node_unreachable")
APART = error("PHM is not on the network", brief="apart", condition="sidecar_disconnected", target="app")
OFF = error("app is not on the network", brief="off", condition="disconnected", target="app")
Start = Callable[..., Agent]


@pytest.fixture
def start() -> Iterator[Start]:
    made: list[Agent] = []

    def begin(**more: Any) -> Agent:
        actions = ("restart", "join_network", "reconnect")
        made.append(Agent(UNITS, Containers("app"), FakeClock(), actions=actions, verify="5s", **more))
        made[-1].rest(3.0)
        return made[-1]

    yield begin
    for agent in made:
        agent.stop()


def visible(agent: Agent) -> bool:
    """Whether each unit in ERROR has a fault, open or given up."""
    bad = {state.unit for state in agent.pipeline.states() if state.level is Level.ERROR}
    return bad <= {fault.unit for fault in (*agent.pipeline.open_faults(), *agent.pipeline.given_up())}


def hung_in_flight(start: Start) -> Agent:
    """A flight-critical node is hung, and a restart is only advised."""
    agent = start(critical=("app",))
    agent.armed = True
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: agent.acted(Phase.ADVISED) == ["restart"], "the advice")
    return agent


def test_a_hung_node_that_becomes_unreachable_is_not_restarted_after_landing(start: Start) -> None:
    """`node_hung` is only advised in flight; it becomes `node_unreachable`, for which nothing is restarted, also on the
    ground.
    """
    agent = hung_in_flight(start)
    agent.found["nodes/one"] = UNREACHABLE
    agent.rest(5.0)
    agent.armed = False
    agent.rest(30.0)
    assert agent.acted() == []
    assert visible(agent)
    assert agent.opened() == ["nodes/one"]


UNKNOWN = stale("the graph is not known")
BUSY = warn("busy", brief="busy", condition="node_busy")


@pytest.mark.parametrize("newer", [UNKNOWN, BUSY])
def test_nothing_is_done_for_what_is_unknown_or_only_a_warning_now(start: Start, newer: Result) -> None:
    """The fault is open and was only advised in flight; after landing a run must find it again. It did for the first attempt, too."""
    agent = hung_in_flight(start)
    agent.found["nodes/one"] = newer
    agent.rest(5.0)
    agent.armed = False
    agent.rest(30.0)
    assert agent.acted() == []
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: agent.acted() == ["restart"], "the restart")


@pytest.mark.parametrize("between", [UNKNOWN, BUSY])
def test_a_condition_that_changes_while_it_is_unknown_or_a_warning_changes_the_fault(
    start: Start, between: Result
) -> None:
    """Hung, then unknown, then unreachable: as if it had become unreachable directly."""
    agent = hung_in_flight(start)
    agent.found["nodes/one"] = between
    agent.rest(2.0)
    agent.found["nodes/one"] = UNREACHABLE
    agent.rest(5.0)
    (fault,) = agent.pipeline.open_faults()
    assert (fault.result.condition, fault.result.target) == ("node_unreachable", "")
    agent.armed = False
    agent.rest(30.0)
    assert agent.acted() == []
    assert agent.opened() == ["nodes/one"]


def test_a_fault_that_gets_a_target_while_it_is_unknown_is_acted_on(start: Start) -> None:
    """Unreachable, unknown, then hung: the worker of the new target gets the fault."""
    agent = start()
    agent.found["nodes/one"] = UNREACHABLE
    agent.rest(5.0)
    agent.found["nodes/one"] = UNKNOWN
    agent.rest(2.0)
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: agent.acted() == ["restart"], "the restart")


def test_a_fault_that_loses_its_target_is_not_acted_on_after_landing(start: Start) -> None:
    """Condition and text are the same as before: the newest result says that no restart helps."""
    agent = hung_in_flight(start)
    agent.found["nodes/one"] = replace(HUNG, target="")
    agent.rest(5.0)
    agent.armed = False
    agent.rest(30.0)
    assert agent.acted() == []
    assert visible(agent)
    assert agent.opened() == ["nodes/one"]


def test_an_unreachable_node_that_becomes_hung_is_restarted(start: Start) -> None:
    """The reverse: a fault without a target gets one."""
    agent = start()
    agent.found["nodes/one"] = UNREACHABLE
    agent.until(lambda: agent.opened() == ["nodes/one"], "the alarm")
    agent.rest(5.0)
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: agent.acted() == ["restart"], "the restart")


def test_the_application_is_reconnected_once_phm_is_back_on_the_network(start: Start) -> None:
    """Both lost it in the same second: PHM first detects its own loss, joins, and then acts on the present failure."""
    agent = start()

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        agent.found.clear()
        if fault.result.condition == "sidecar_disconnected":
            agent.found["network/app"] = OFF

    agent.behave = behave
    agent.found["network/app"] = APART
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the recovery of the application")
    assert agent.acted() == ["join_network", "reconnect"]
    (closed,) = agent.closed()
    assert (closed.fault.outcome, closed.fault.by) == (Outcome.RESOLVED, "reconnect")


def test_a_given_up_fault_is_acted_on_when_its_condition_changes(start: Start) -> None:
    """PHM could not join and gave up; then the application loses the network. Each condition is reported once."""
    agent = start()
    agent.behave = lambda *_: None
    agent.found["network/app"] = APART
    agent.until(lambda: Phase.ESCALATED in agent.steps(), "giving up")
    assert agent.acted() == ["join_network"] * 3
    assert visible(agent)
    agent.behave = lambda *_: agent.found.clear()
    agent.found["network/app"] = OFF
    agent.until(lambda: agent.acted()[-1] == "reconnect", "the reconnection")
    agent.until(lambda: not agent.pipeline.open_faults(), "the end of the fault")
    assert agent.opened() == ["network/app"] * 2


def test_an_alternating_fault_is_given_up_once(start: Start) -> None:
    """Two alternating conditions, both given up, do not raise one alarm after another."""
    agent = start()
    agent.behave = lambda *_: None
    agent.found["network/app"] = APART
    agent.until(lambda: agent.steps().count(Phase.ESCALATED) == 1, "giving up")
    agent.found["network/app"] = OFF
    agent.until(lambda: agent.steps().count(Phase.ESCALATED) == 2, "giving up again")
    opened, acted = len(agent.opened()), len(agent.acted())
    for found in (APART, OFF, APART, OFF):
        agent.found["network/app"] = found
        agent.rest(10.0)
        assert visible(agent)
        (fault,) = agent.pipeline.given_up()
        assert fault.result.condition == found.condition
    assert (len(agent.opened()), len(agent.acted())) == (opened, acted)


def test_other_faults_are_checked_again_after_one_was_recovered(start: Start) -> None:
    """A restart for one fault also resolves the other, which takes a moment to show: no second restart follows."""
    agent = start(ladders={"broken": ["restart"]})
    agent.bad.update({"container/app": "broken", "nodes/one": "broken"})

    def behave(key: str, *_: object) -> None:
        agent.containers.start(key)
        agent.bad.pop("container/app", None)

    agent.behave = behave
    agent.until(lambda: Phase.DONE in agent.steps(), "the restart")
    agent.until(lambda: Phase.VERIFIED in agent.steps() or len(agent.acted()) > 1, "its verification")
    del agent.bad["nodes/one"]
    agent.rest(20.0)
    assert agent.acted() == ["restart"]


def test_a_waiting_action_does_not_count_as_an_attempt(start: Start) -> None:
    """The network is missing: reported once, and done when it exists, with all attempts left."""
    agent = start()
    agent.behave = lambda *_: agent.found.clear()
    agent.missing = "there is no network swarm"
    agent.found["network/app"] = OFF
    agent.rest(60.0)
    assert agent.steps() == [Phase.REFUSED]
    agent.missing = ""
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the reconnection")
    assert agent.steps() == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_a_fault_that_waits_for_a_network_delays_no_other_fault(start: Start) -> None:
    """Its step is postponed, and the next fault is decided on."""
    agent = start()
    agent.missing, agent.not_missing = "there is no network swarm", {"nodes/one"}
    agent.found["network/app"] = OFF
    agent.until(lambda: Phase.REFUSED in agent.steps(), "the wait for the network")
    agent.found["nodes/one"] = HUNG
    agent.until(lambda: agent.runs, "the other fault's action")
    assert agent.runs[0] == ("app", "nodes/one")


def test_an_approval_is_acted_on_while_another_fault_waits_for_a_network(start: Start) -> None:
    """Otherwise it would expire before anything was done."""
    agent = start(mode="advise")
    agent.missing, agent.not_missing = "there is no network swarm", {"nodes/one"}
    agent.found = {"network/app": OFF, "nodes/one": HUNG}
    agent.until(lambda: len(agent.acted(Phase.ADVISED)) == 2, "the advice")
    faults = {fault.unit: fault.id for fault in agent.pipeline.open_faults()}
    agent.executor.approve(faults["network/app"])
    agent.until(lambda: Phase.REFUSED in agent.steps(), "the wait for the network")
    agent.executor.approve(faults["nodes/one"])
    agent.until(lambda: agent.runs, "the approved action")
    assert agent.runs[0] == ("app", "nodes/one")
