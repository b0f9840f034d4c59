"""A container that is down in flight, where only its start is allowed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from phm.api import stale
from phm.core.model import Fault, Phase
from phm.recovery.base import Action, ActionContext, Impact, NotNeeded
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

UNITS = {"container/app": Of("app"), "nodes/app": Of("app", ("container/app",), grace_s=8.0)}
LADDERS = {"exited": ["start", "restart"], "node_missing": ["restart"]}


class InFlight(Agent):
    """A restart of `app` would take down `fc`, which is flight-critical and uses its network. `start` brings back no node."""

    def __init__(self) -> None:
        containers = Containers("app", "fc")
        shared = f"container:{containers.facts['app'].id}"
        containers.facts["fc"] = replace(containers.facts["fc"], network_mode=shared)
        super().__init__(
            UNITS, containers, FakeClock(), critical=("fc",), actions=("start", "restart"), ladders=LADDERS
        )
        self.behave, self.armed = self._act, True

    def _action(self, of: str) -> type[Action]:
        made = super()._action(of)
        if of == "start":
            made.impact, made.verify_after_s = Impact.NOTHING, 2.0
        return made

    def _act(self, key: str, context: ActionContext, fault: Fault) -> object:
        if self.containers.facts[key].status == "running":
            return NotNeeded(f"{key} is already running")
        self.containers.start(key)
        self.pipeline.container_started(key)
        self.bad = {"nodes/app": "node_missing"}
        self.found.clear()
        return ""


@pytest.fixture
def agent() -> Iterator[InFlight]:
    made = InFlight()
    made.rest(12.0)
    yield made
    made.stop()
    made.clock.advance(1000)


def test_a_start_has_worked_in_flight_although_a_node_is_not_back(agent: InFlight) -> None:
    """The restart that would follow is forbidden, and another start of a container that runs does nothing: the node is reported."""
    agent.containers.end("app")
    agent.pipeline.container_ended("app")
    agent.bad["container/app"], agent.found["nodes/app"] = "exited", stale("not running")
    agent.until(lambda: agent.acted(Phase.ADVISED), "the advice")
    assert agent.opened() == ["container/app", "nodes/app"]
    assert agent.acted() == ["start"]
    assert agent.acted(Phase.VERIFIED) == ["start"]
    assert agent.acted(Phase.ESCALATED) == []
    assert agent.acted(Phase.ADVISED) == ["restart"]


def test_on_the_ground_the_next_step_follows(agent: InFlight) -> None:
    """As long as it is allowed."""
    agent.armed = False
    agent.containers.end("app")
    agent.pipeline.container_ended("app")
    agent.bad["container/app"], agent.found["nodes/app"] = "exited", stale("not running")
    agent.until(lambda: len(agent.acted()) > 1, "the next step")
    assert agent.acted() == ["start", "restart"]
