"""A node that had ended before its container was reconnected: a fault that is reported meanwhile, and recovered once."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.api import error
from phm.core.model import Evidence, Fault
from phm.recovery.base import ActionContext
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

NETWORK, NODE = "network/app", "nodes/app"
UNITS = {
    "container/app": Of("app"),
    NETWORK: Of("app", ("container/app",)),
    NODE: Of("app", ("container/app", NETWORK), grace_s=2.0),
}


class Lost(Agent):
    """`reconnect` takes 2 s and may restart the container, which brings the node back; so does `restart`."""

    def __init__(self, *, restarts: bool) -> None:
        steps = {"ladders": {"node_missing": ["restart"]}, "backoff": 0.1}
        super().__init__(UNITS, Containers("app"), FakeClock(), actions=("reconnect", "restart"), **steps)
        self.restarts, self.done = restarts, ""
        self.behave = self._act
        self.rest(3.0)

    def _act(self, key: str, context: ActionContext, fault: Fault) -> None:
        due = self.clock.mono() + 2.0
        self.pause(lambda: self.clock.mono() >= due)
        self.bad.pop(NETWORK, None)
        if self.restarts or fault.unit == NODE:
            self.containers.start(key)
            self.pipeline.container_started(key)
            self.found.clear()

    def lose(self) -> None:
        """The network, and before PHM acts the process of the node."""
        ended = self.clock.mono()
        seen = Evidence(certain=True, conclusive=True, observed=ended)
        self.bad[NETWORK] = "disconnected"
        self.until(lambda: self.acting, "the reconnection")
        gone = error("ended", brief="dead", condition="node_missing", target="app")
        self.found[NODE] = gone.with_evidence(seen)

    def by(self) -> dict[str, str]:
        return {event.fault.unit: event.fault.by for event in self.closed()}


@pytest.fixture
def agents() -> Iterator[list[Lost]]:
    made: list[Lost] = []
    yield made
    for agent in made:
        agent.stop()
        agent.clock.advance(1000)


@pytest.mark.parametrize("restarts", [True, False])
def test_the_node_is_reported_during_the_reconnection_and_restarted_once(agents: list[Lost], *, restarts: bool) -> None:
    """By the reconnection, if that restarts the container; else by its own recovery, after the other one."""
    agents.append(agent := Lost(restarts=restarts))
    agent.lose()
    agent.until(lambda: NODE in agent.opened(), "the second alarm")
    assert agent.acting == ["app"] and len(agent.runs) == 1
    agent.rest(30.0)
    assert agent.opened() == [NETWORK, NODE]
    assert agent.acted() == (["reconnect"] if restarts else ["reconnect", "restart"])
    assert agent.by() == {NETWORK: "reconnect", NODE: "reconnect" if restarts else "restart"}
