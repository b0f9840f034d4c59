"""Recovery while the Docker Engine does not respond: it waits, and no attempt is spent."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from phm.api import error
from phm.core.model import Phase
from phm.testing import FakeClock
from tests.recovery.simulated_agent import Agent, Containers, Of

DOWN = error("no answer", brief="Docker not responding", condition="engine_down")
REFUSED = error("denied", brief="Docker denies access", condition="engine_refused")
HUNG = error("hung", brief="hung", condition="node_hung", target="app")


@pytest.fixture
def agent() -> Iterator[Agent]:
    found = Agent({"engine": Of(""), "nodes/one": Of("app")}, Containers("app"), FakeClock(), verify="5s")
    found.behave = lambda *_: found.found.pop("nodes/one", None)
    found.rest(3.0)
    yield found
    found.stop()


def test_an_action_waits_until_the_engine_responds(agent: Agent) -> None:
    """Three attempts that cannot succeed would end in giving up, and the container would stay down for good."""
    agent.found |= {"engine": DOWN, "nodes/one": HUNG}
    agent.rest(120.0)
    assert agent.steps() == [Phase.REFUSED]
    assert agent.runs == []
    del agent.found["engine"]
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
    assert agent.steps() == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_an_engine_that_refuses_a_question_may_permit_an_action(agent: Agent) -> None:
    """A proxy may forbid one call and allow the other."""
    agent.found |= {"engine": REFUSED, "nodes/one": HUNG}
    agent.until(lambda: Phase.VERIFIED in agent.steps(), "the restart")
