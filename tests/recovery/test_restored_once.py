"""What PHM's own restart of a container has broken is restored, once."""

from __future__ import annotations

import pytest

from phm.core.model import Fault, Phase
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

GRACE_S = 8.0
NODES, CONSENSUS = "nodes/app", "consensus/app"
LOST = "publisher_not_received"


@pytest.mark.parametrize("restored", [True, False])
def test_nodes_that_do_not_find_each_other_after_a_restart_by_phm(restored: bool) -> None:
    """A node hangs, and PHM restarts its container during an overload: two of its nodes never find each other. In this run they never
    did, but they did before. If one more restart does not help, PHM gives up.
    """
    units = {
        "container/app": Of("app"),
        NODES: Of("app", ("container/app",), grace_s=GRACE_S),
        CONSENSUS: Of("app", ("container/app", NODES), grace_s=GRACE_S),
    }
    agent = Agent(units, Containers("app"), FakeClock(), verify="30s", ladders={"hung": ["restart"]})
    agent.rest(30.0)

    def behave(key: str, context: ActionContext, fault: Fault) -> None:
        agent.containers.start(key)
        agent.pipeline.container_started(key)
        agent.bad = {} if restored and fault.unit == CONSENSUS else {CONSENSUS: LOST}

    agent.behave = behave
    agent.bad = {NODES: "hung"}
    agent.until(lambda: bool(agent.runs), "the restart")
    agent.rest(300.0)
    assert len(agent.runs) == 2
    assert (Phase.ESCALATED in agent.steps()) is not restored
    agent.stop()


def test_nodes_that_do_not_find_each_other_after_an_operators_restart() -> None:
    """It may have brought other code: nothing is done."""
    units = {"container/app": Of("app"), CONSENSUS: Of("app", ("container/app",), grace_s=GRACE_S)}
    agent = Agent(units, Containers("app"), FakeClock(), verify="30s")
    agent.rest(30.0)
    agent.bad = {CONSENSUS: LOST}
    agent.containers.start("app")
    agent.pipeline.container_started("app")
    agent.rest(120.0)
    assert agent.opened() == [CONSENSUS]
    assert agent.runs == []
    agent.stop()
